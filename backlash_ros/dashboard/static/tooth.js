// The tooth of the motor's gear in the gap of the load's gear. The teeth are drawn as involutes are, the gap to scale.

import { digits, inGaps, span } from "./steps.js";

const GAP = 90; // px: the gap is as wide in the drawing, whatever it is in rad
const TOOTH = 118; // px at the pitch line
const PITCH = 92, ROOT = 44, TIP = 39; // px: height of the pitch line, and from there to root and tip
const SLOPE = 0.36, CURVE = 0.0034; // of a flank: tan 20 deg, and how it bends, 1/px; so two flanks touch at the pitch line
const HALF = 230; // px: half of the frame
const REACH = 0.9; // gaps that the load is drawn from the middle, at most: farther, the view follows it
const CLEAR = 0.42; // gaps: as far as a tooth that does not touch is drawn from the middle
const TRAIL = 16; // pictures of the last second
const SECOND = 1; // s
const HARDLY = 2e-3; // share of the strongest force seen below which teeth do not count as pressed
const LEAST_FORCE = 1e-4; // N m: and in any case

const clip = (value, most) => Math.max(-most, Math.min(most, value));

// The points of a tooth's right flank, from root to tip; `up` is 1 or -1.
const flank = (up) => Array.from({ length: 13 }, (_, i) => {
  const h = -ROOT + ((ROOT + TIP) * i) / 12;
  return [TOOTH / 2 - SLOPE * h - CURVE * h * h, PITCH - up * h];
});

const outline = (at, up) => {
  const right = flank(up), left = right.map(([x, y]) => [-x, y]).reverse();
  return [...right, ...left].map(([x, y]) => `${(at + x).toFixed(1)} ${y.toFixed(1)}`).join("L");
};

// Teeth at their places, on a body that begins at their roots.
const gear = (places, up) => {
  const root = PITCH + up * ROOT, back = root + up * 34;
  const teeth = places.map((at) => outline(at, up)).reverse(); // from right to left
  return `M900 ${root}L${teeth.join("L")}L-900 ${root}L-900 ${back}L900 ${back}Z`;
};

const SPACE = TOOTH + GAP / 2; // from the middle of a gap to that of the next tooth
const MOTOR = gear([-2 * SPACE, 0, 2 * SPACE], -1);
const LOAD = gear([-3 * SPACE, -SPACE, SPACE, 3 * SPACE], 1);
const DRAWING = `
  <title>The tooth of the motor's gear in the gap of the load's gear, magnified</title>
  <defs><radialGradient id="glow"><stop offset="0" class="hot"/><stop offset="1" class="cold"/></radialGradient></defs>
  <g id="trail">${`<g><path class="load" d="${LOAD}"/><path class="motor" d="${MOTOR}"/></g>`.repeat(TRAIL)}</g>
  <path class="load solid" id="load-gear" d="${LOAD}"/>
  <path class="motor solid" id="motor-gear" d="${MOTOR}"/>
  <circle id="force" cy="${PITCH}" r="34" fill="url(#glow)"/>
  <text id="figure" y="${PITCH + 5}" text-anchor="middle"></text><text id="of-figure" y="${PITCH + 21}" text-anchor="middle">tooth force</text>
  <path id="target" d="M0 ${PITCH + ROOT}v34"/><text id="target-text"></text>
  <text x="${-HALF + 6}" y="34">motor</text><text x="${-HALF + 6}" y="158">load</text>
  <path id="scale" d="M${-HALF + 8} 178v8h${GAP}v-8"/><text id="scale-text" x="${-HALF + 16 + GAP}" y="188"></text>`;

export class Tooth {
  constructor(svg, words) {
    this.svg = svg;
    this.words = words;
    svg.setAttribute("viewBox", `${-HALF} 0 ${2 * HALF} 194`);
    svg.innerHTML = DRAWING;
    this.trail = [...svg.querySelector("#trail").children];
    this.forget();
  }

  // Of another axis, or after a fault, when the encoders may count from elsewhere.
  forget() {
    this.low = this.high = undefined; // of the twist, motor minus load
    this.sure = false; // whether both flanks were seen
    this.strongest = 0;
  }

  find(name) {
    return this.svg.querySelector(`#${name}`);
  }

  tell(text) {
    if (this.words.textContent !== text) this.words.textContent = text;
  }

  draw(joints, state, { b, simulated, gap, small }) {
    if (!joints.length) return;
    const motor = joints.of("motor"), load = joints.of("load"), now = joints.length - 1;
    const recent = joints.from(joints.last("time") - SECOND);
    const seen = !Number.isNaN(motor[now] - load[now]);
    this.svg.classList.toggle("unseen", !seen);
    if (!seen) return this.tell("Without both encoders, no tooth can be drawn.");
    if (state.last("fault")) this.forget();
    const { width, middle } = this.place(motor, load, recent, b || gap);
    [this.middle, this.sure] = [middle, this.high - this.low >= 0.8 * width];
    const setpoint = state.last("setpoint") + (state.last("offset") || 0);
    const off = Number.isFinite(setpoint) ? (load[now] - setpoint) / width : 0;
    const x = clip(off, REACH) * GAP; // of the load, in the frame
    const torque = simulated ? joints.last("gear_torque") : NaN;
    const twist = (motor[now] - load[now] - middle) / width;
    const side = this.side(twist, torque);
    const tooth = x + GAP * (side ? side / 2 : clip(twist, CLEAR));
    this.find("load-gear").setAttribute("transform", `translate(${x} 0)`);
    this.find("motor-gear").setAttribute("transform", `translate(${tooth} 0)`);
    this.past(joints, recent, load[now] - (x / GAP) * width, middle, width);
    this.press(side, torque, tooth);
    this.frame(off, x, width, b, gap, small);
    const twists = state.last("fault") ? 0 : this.twists(motor, load, recent) / width;
    if (side !== this.side_ || performance.now() - (this.told || 0) > 250) {
      this.side_ = side;
      this.told = performance.now();
      this.tell(this.inWords(side, twists, load, recent, b, small));
    }
  }

  // Where the middle of the gap is: between the flanks where both were seen, else as near to 0 as what was seen allows.
  place(motor, load, recent, known) {
    const { low, high } = this;
    for (let i = low === undefined ? motor.length - 1 : recent; i < motor.length; i++) {
      const value = motor[i] - load[i];
      if (!(this.low <= value)) this.low = value;
      if (!(this.high >= value)) this.high = value;
    }
    const width = known || Math.max(this.high - this.low, 1e-6);
    const [least, most] = [this.high - width / 2, this.low + width / 2];
    return { width, middle: least > most ? (least + most) / 2 : Math.min(Math.max(0, least), most) };
  }

  // The flank that the tooth presses on: by the force where it is known, else by its place.
  side(twist, torque) {
    if (Number.isNaN(torque)) return Math.abs(twist) > 0.48 ? Math.sign(twist) : 0;
    this.strongest = Math.max(this.strongest, Math.abs(torque));
    return Math.abs(torque) > Math.max(HARDLY * this.strongest, LEAST_FORCE) ? Math.sign(torque) : 0;
  }

  // The last second behind it: from each part of it the outermost place of load or motor, to either side in turn.
  past(joints, recent, centre, middle, width) {
    const motor = joints.of("motor"), load = joints.of("load"), count = motor.length - recent;
    this.trail.forEach((picture, k) => {
      const [from, to] = [k, k + 1].map((part) => recent + Math.floor((count * part) / TRAIL));
      let at = from;
      const [one, sign] = [k % 4 < 2 ? load : motor, k % 2 ? 1 : -1];
      for (let i = from; i < to; i++) if ((one[i] - one[at]) * sign > 0) at = i;
      const x = ((load[at] - centre) / width) * GAP;
      const twist = clip((motor[at] - load[at] - middle) / width, 0.5);
      const visible = Number.isFinite(x + twist) && Math.abs(x) < 2 * HALF;
      picture.style.display = visible ? "" : "none";
      picture.style.opacity = (0.5 * (k + 1)) / TRAIL;
      if (!visible) return;
      picture.children[0].setAttribute("transform", `translate(${x} 0)`);
      picture.children[1].setAttribute("transform", `translate(${x + twist * GAP} 0)`);
    });
  }

  press(side, torque, tooth) {
    const glow = this.find("force"), known = side !== 0 && !Number.isNaN(torque);
    glow.style.display = side ? "" : "none";
    glow.setAttribute("cx", tooth + (side * TOOTH) / 2);
    glow.style.opacity = known ? 0.45 + 0.55 * Math.sqrt(Math.abs(torque) / this.strongest) : 0.7;
    const figure = this.find("figure");
    figure.textContent = known ? `${side < 0 ? "\u2190 " : ""}${digits(Math.abs(torque), 2)} N m${side > 0 ? " \u2192" : ""}` : "";
    for (const text of [figure, this.find("of-figure")]) text.setAttribute("x", tooth);
    this.find("of-figure").style.display = known ? "" : "none";
  }

  // The target in the view, or the way to it, and the scale.
  frame(off, x, width, b, gap, small) {
    const at = x - off * GAP, inside = Math.abs(at) < HALF - 65;
    this.find("target").style.display = inside ? "" : "none";
    this.find("target").setAttribute("transform", `translate(${at} 0)`);
    const text = this.find("target-text");
    text.setAttribute("x", inside ? at + 6 : 40);
    text.setAttribute("y", inside ? 158 : 188);
    const far = `${digits(Math.abs(off), 2)} ${b ? "b" : "gaps"}`;
    text.textContent = inside ? "target" : at > 0 ? `target in ${far} \u2192` : `\u2190 target in ${far}`;
    const size = `${digits(width * small.factor, 3)} ${small.name}`;
    this.find("scale-text").textContent = `${b ? "b =" : gap ? "simulated gap" : "gap, as seen,"} ${size}`;
  }

  // How far the tooth moved in the gap in the last second, rad.
  twists(motor, load, recent) {
    let low = Infinity, high = -Infinity;
    for (let i = recent; i < motor.length; i++) {
      low = Math.min(low, motor[i] - load[i]);
      high = Math.max(high, motor[i] - load[i]);
    }
    return high - low;
  }

  inWords(side, twists, load, recent, b, small) {
    const [low, high] = span(load, recent), swing = inGaps(high - low, b, small);
    const flank = side > 0 ? "drives the load on" : side < 0 ? "holds the load back" : "is between the flanks";
    const does = twists > 0.9 ? "beats on both flanks" : twists > 0.3 ? "moves to and fro in the gap" : flank;
    return `The load moved by ${swing} in the last second. The tooth ${does}.`;
  }
}
