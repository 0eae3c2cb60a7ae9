// Curves, drawn from the samples that the server sends; and the stop.

import { SWING, Steps, first, span } from "./steps.js";
import { Tooth } from "./tooth.js";

const KEPT = 65; // s of samples that are kept
const FRAME = 50; // ms between two pictures
const POINTS = 600; // places along a curve; each shows the least and the largest value there
const HOLE = 10; // usual times between two points that interrupt a curve
const NEAR = 0.01; // share of the time shown: as far from the cursor a curve has a value

export class Table {
  constructor(columns) {
    this.columns = columns;
    this.values = columns.map(() => []);
  }
  get length() {
    return this.values[0].length;
  }
  of(name) {
    return this.values[this.columns.indexOf(name)];
  }
  last(name) {
    return this.length ? this.of(name)[this.length - 1] : NaN;
  }
  add(numbers) {
    const width = this.columns.length;
    for (let i = 0; i < numbers.length; i += width) {
      if (this.length && numbers[i] < this.last("time")) this.values.forEach((column) => (column.length = 0)); // time began anew
      for (let k = 0; k < width; k++) this.values[k].push(numbers[i + k]);
    }
    const time = this.values[0];
    if (time.length && time[time.length - 1] - time[0] > 1.2 * KEPT) {
      const old = this.from(time[time.length - 1] - KEPT);
      this.values.forEach((column) => column.splice(0, old));
    }
  }
  from(when) {
    return first(this.values[0], when);
  }
  // The time without a row that counts as a hole, s.
  get hole() {
    const time = this.values[0], step = Math.max(1, time.length >> 5), between = [];
    for (let i = 1; i < time.length; i += step) between.push(time[i] - time[i - 1]);
    return HOLE * (between.sort((a, b) => a - b)[between.length >> 1] ?? Infinity);
  }
}

// The points of a curve, in `unit`, from one place to another; it is interrupted where times or values are missing.
function thin(time, values, [from, to], zero, hole, unit = 1) {
  const step = Math.max(1, Math.floor((to - from) / POINTS));
  const points = [];
  for (let i = from, next; i < to; i = next) {
    if (i > from && time[i] - time[i - 1] > hole) points.push([time[i - 1] - zero, null]);
    let least = i, largest = i;
    for (next = i + 1; next < Math.min(to, i + step) && time[next] - time[next - 1] <= hole; next++) {
      if (values[next] < values[least] || Number.isNaN(values[least])) least = next;
      if (values[next] > values[largest] || Number.isNaN(values[largest])) largest = next;
    }
    const ends = least < largest ? [least, largest] : [largest, least];
    for (const end of new Set(ends)) points.push([time[end] - zero, Number.isNaN(values[end]) ? null : unit * values[end]]);
  }
  return points;
}

function niceLimit(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return power * [1, 1.5, 2, 3, 5, 7.5, 10].find((step) => step * power >= value);
}

const ROWS = [["angle", 24], ["error", 25], ["command", 16], ["load torque, as estimated, N m", 15], ["gains", 14]];
const NARROW = 600; // px; a narrower chart has the first two rows alone
const TALL = 470; // px; in a lower chart a low row has two labels
const BAND = [[{ yAxis: -0.5 }, { yAxis: 0.5 }]]; // the gap, about the target
const GHOST = "step before";
const PALE = 0.35, PALE_IN_DARK = 0.6; // opacity of the ghost: what rattled must not look like now
const PLANS = { name: "flank, as planned", min: -2, max: 2, words: { 1: "forward", 0: "none", "-1": "back" } }; // of the law of planned moves
const ACTS = { name: "gains that act", min: 0, max: 3, words: { 1: "fast", 2: "damped" } }; // of the others
const CURVES = [
  [GHOST, 0, "load", "dashed"], [GHOST, 1, "load", "dashed"], // below the others
  ["load", 0, "load"], ["motor through the gear", 0, "motor"], ["setpoint", 0, "faint", "dashed"],
  ["error", 1, "load"],
  ["command", 2, "command"], ["limits", 2, "faint", "dotted"], ["lower limit", 2, "faint", "dotted"],
  ["load torque", 3, "torque"],
  ["region", 4, "command"], ["flank", 4, "motor", "dashed"],
];
const LEAST_SPAN = [1e-3, 0, 0.1, 1e-3, 0]; // of an axis by its row, in rad or its unit, so that no rounding noise fills it

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

class Live {
  constructor(options) {
    this.options = options;
    this.window = 10;
    this.paused = false;
    this.drawn = 0;
    this.chart = options.chart;
    this.chart.on("datazoom", () => this.onZoom());
    this.tooth = new Tooth(document.getElementById("tooth"), document.getElementById("tooth-text"));
    this.steps = new Steps(document.getElementById("steps"));
    this.forget();
    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.layOut());
    new ResizeObserver(() => (this.narrow !== this.chart.getWidth() < NARROW || this.tall !== this.chart.getHeight() > TALL) && this.layOut()).observe(this.chart.getDom());
    this.layOut();
    const draw = () => {
      const now = performance.now();
      if (now - this.drawn >= FRAME - 2) {
        this.drawn = now;
        this.draw();
        const took = performance.now() - now;
        this.drawn = now + Math.max(0, 2 * took - FRAME); // a slow browser rests for as long as it draws
      }
      requestAnimationFrame(draw);
    };
    requestAnimationFrame(draw);
  }

  connect() {
    const axis = this.axis;
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    this.socket = new WebSocket(`${scheme}://${location.host}/samples?axis=${encodeURIComponent(axis)}`);
    this.socket.binaryType = "arraybuffer";
    this.socket.onmessage = (event) => {
      const [joints] = new Float64Array(event.data, 0, 1); // bytes of joint states; states follow
      this.joints.add(new Float64Array(event.data, 8, joints / 8));
      this.state.add(new Float64Array(event.data, 8 + joints));
      this.frames = (this.frames || 0) + 1;
    };
    this.socket.onclose = () => setTimeout(() => axis === this.axis && this.connect(), 1000);
  }

  forget() {
    this.joints = new Table(this.options.joints);
    this.state = new Table(this.options.state);
    this.tooth.forget();
    this.steps.forget();
  }

  watch(axis) {
    this.axis = axis;
    this.forget();
    if (this.socket) {
      this.socket.onclose = null;
      this.socket.close();
    }
    this.connect();
    this.live();
  }

  layOut() {
    this.narrow = this.chart.getWidth() < NARROW;
    this.tall = this.chart.getHeight() > TALL;
    const rows = this.narrow ? ROWS.slice(0, 2) : ROWS;
    const whole = rows.reduce((sum, [, height]) => sum + height, 0);
    const pale = window.matchMedia("(prefers-color-scheme: dark)").matches ? PALE_IN_DARK : PALE;
    const text = colour("ink"), line = colour("line"), { factor } = (this.angle = this.options.facts().angle);
    const axis = { type: "value", axisLine: { onZero: false, lineStyle: { color: line } }, splitLine: { lineStyle: { color: line } } };
    let top = this.narrow ? 9 : 5;
    const grids = [], x = [], y = [];
    rows.forEach(([name, part], i) => {
      const least = LEAST_SPAN[i] * (i ? 1 : factor);
      const last = i === rows.length - 1, height = ((99 - (this.narrow ? 9 : 5)) * part) / whole;
      grids.push({ left: 64, right: 16, top: `${top}%`, height: `${height - (this.narrow ? 10 : 5)}%`, outerBoundsMode: "none" });
      top += height;
      x.push({ ...axis, gridIndex: i, axisLabel: { show: last, color: text, alignMaxLabel: "right", formatter: (v) => `${+v.toFixed(3)} s` }, axisTick: { show: last } });
      y.push({
        ...axis, gridIndex: i, name, nameLocation: "end", nameGap: 6, scale: true, splitNumber: i < 2 ? 3 : 2,
        nameTextStyle: { color: text, align: "left", padding: [0, 0, 0, -56] },
        axisLabel: { color: text, showMaxLabel: false, showMinLabel: i > 1 && (i === 4 || this.tall), fontSize: i === 4 ? 10 : 12, hideOverlap: true, formatter: (v) => `${+v.toFixed(6)}` },
        min: ({ min, max }) => (max - min < least ? (min + max - least) / 2 : null),
        max: ({ min, max }) => (max - min < least ? (min + max + least) / 2 : null),
      });
    });
    if (!this.narrow) y[4].interval = 1;
    this.curves = CURVES.filter(([, row]) => row < rows.length);
    const series = this.curves.map(([name, row, hue, type = "solid"]) => ({
      id: `${name} ${row}`, name, type: "line", xAxisIndex: row, yAxisIndex: row, showSymbol: false, animation: false, data: [], step: row === 4 ? "end" : false,
      lineStyle: { width: type === "dotted" || name === GHOST ? 1 : 1.4, color: colour(hue), type, opacity: name === GHOST ? pale : 1 },
      itemStyle: { color: colour(hue), opacity: name === GHOST ? pale : 1 },
    }));
    const [band, setpoint] = ["error", "setpoint"].map((of) => series.find(({ name }) => name === of));
    const ends = { formatter: "end of the travel", position: "insideStartBottom", color: text, fontSize: 11 };
    setpoint.markLine = { silent: true, animation: false, symbol: "none", lineStyle: { color: colour("bad"), type: "solid" }, label: ends, data: [] };
    band.markArea = { silent: true, itemStyle: { color: colour("good"), opacity: 0.13 }, data: [] };
    this.chart.setOption({
      animation: false,
      aria: { enabled: true, label: { description: "Angles, error, command, load torque and region over time, as they are now." } },
      backgroundColor: "transparent",
      textStyle: { color: text, fontFamily: "system-ui, sans-serif" },
      grid: grids, xAxis: x, yAxis: y, series,
      tooltip: {
        trigger: "axis", confine: true, transitionDuration: 0, padding: [4, 8], formatter: ([{ axisValue }]) => this.atCursor(axisValue),
        backgroundColor: colour("paper"), borderColor: line, textStyle: { color: text, fontSize: 12 },
      },
      axisPointer: { link: [{ xAxisIndex: "all" }] },
      legend: {
        type: "scroll", top: 0, left: 96, right: this.narrow ? 0 : 8, itemHeight: 8, itemWidth: this.narrow ? 12 : 25, itemGap: this.narrow ? 4 : 10,
        textStyle: { color: text, fontSize: this.narrow ? 11 : 12 }, data: ["setpoint", "load", "motor through the gear", GHOST],
        formatter: (name) => (this.narrow ? name.replace(/ through the gear|step (?=before)/, "") : name),
      },
      dataZoom: [{ type: "inside", xAxisIndex: rows.map((_, i) => i), filterMode: "none" }],
    }, { replaceMerge: ["grid", "xAxis", "yAxis", "series", "dataZoom"] });
    this.fill();
  }

  live() {
    this.paused = false;
    this.chart.dispatchAction({ type: "dataZoom", start: 0, end: 100 });
    this.paused = false;
    this.tell();
  }
  pause() {
    this.paused = true;
    this.fill();
    this.tell();
  }
  onZoom() {
    const { start, end } = this.chart.getOption().dataZoom[0];
    if (start > 0 || end < 100) {
      this.paused = true;
      this.tell();
    }
    if (this.paused) this.fill();
  }
  zoom(factor, shift = 0) {
    this.paused = true;
    const { start, end } = this.chart.getOption().dataZoom[0];
    const half = Math.min(50, ((end - start) / 2) * factor);
    const middle = Math.min(100 - half, Math.max(half, (start + end) / 2 + shift * 2 * half));
    this.chart.dispatchAction({ type: "dataZoom", start: middle - half, end: middle + half });
    this.tell();
  }
  tell() {
    document.documentElement.dataset.paused = this.paused;
  }
  setWindow(seconds) {
    this.window = seconds;
    this.live();
  }

  get b() {
    const learned = this.state.last("backlash_angle");
    return learned > 0 ? learned : 0;
  }

  // Setpoint minus load, rad, of samples from one place to another; NaN where the setpoint is missing.
  errors(from, to) {
    const { joints, state } = this;
    const time = joints.of("time"), load = joints.of("load"), told = state.of("time"), { hole } = state;
    const setpoint = state.of("setpoint"), offset = state.of("offset"), errors = [];
    let k = Math.max(0, state.from(time[from]) - 1);
    for (let i = from; i < to; i++) {
      while (k + 1 < told.length && told[k + 1] <= time[i]) k++;
      errors.push(told[k] <= time[i] && time[i] - told[k] <= hole ? setpoint[k] + offset[k] - load[i] : NaN);
    }
    return errors;
  }

  // Time and values at the cursor, s from the newest sample.
  atCursor(at) {
    const rows = this.curves.flatMap(([name, row, hue], k) => {
      const points = this.points[k], after = points.findIndex(([time]) => time >= at);
      const [time, value] = points[after > 0 && at - points[after - 1][0] < points[after][0] - at ? after - 1 : after] ?? [NaN, null];
      if (value === null || !(Math.abs(time - at) < NEAR * this.window)) return []; // it is missing there
      const words = this.options.words[name]?.[value] ?? `${+(+value.toPrecision(4)).toFixed(6)} ${this.units[row]}`;
      return [`<span style="color: ${colour(hue)}">\u25cf</span> ${name} <b>${words}</b>`];
    });
    return [`${at.toFixed(3)} s`, ...rows].join("<br>");
  }

  fill() {
    const { joints, state, chart, steps } = this;
    if (!this.paused || this.zero === undefined) {
      const newest = Math.max(joints.length ? joints.last("time") : -Infinity, state.length ? state.last("time") : -Infinity);
      if (!Number.isFinite(newest)) return;
      this.newest = newest;
      this.zero = newest;
    }
    const { start, end } = this.paused ? chart.getOption().dataZoom[0] : { start: 0, end: 100 };
    const begin = this.newest - this.window;
    const left = begin + (this.window * start) / 100, right = begin + (this.window * end) / 100;
    const shown = (time) => [Math.max(0, first(time, left) - 1), Math.min(time.length, first(time, right) + 1)];
    const jt = joints.of("time"), st = state.of("time"), [j0, j1] = shown(jt), s = shown(st);
    const { b } = this, { name, factor, small } = this.angle;
    const unit = b ? 1 / b : small.factor;
    const errors = this.errors(j0, j1);
    // The scale is that of the last second, so that a rattle is seen beside the step that came before it.
    const [low, high] = span(errors, Math.max(0, joints.from(this.newest - SWING) - j0));
    const half = b ? 0.75 : 1e-3 * small.factor;
    const scale = niceLimit(Math.max(half, Number.isFinite(low) ? 1.3 * unit * Math.max(-low, high) : half));
    const of = (column, factor) => thin(st, state.of(column), s, this.zero, state.hole, factor);
    const { unit: command, plans, travel = [] } = this.options.facts();
    const limit = (column) => (command === "V" ? of(column) : []); // limits are told in V
    const joint = (column) => thin(jt, joints.of(column), [j0, j1], this.zero, joints.hole, factor);
    const ghost = (column, factor) => (steps.ghost ? thin(steps.ghost.time, steps.ghost[column], shown(steps.ghost.time), this.zero, Infinity, factor) : []);
    const data = {
      [GHOST]: [ghost("load", factor), ghost("error", unit)],
      load: [joint("load")], "motor through the gear": [joint("motor")], setpoint: [of("setpoint", factor)],
      error: [[], thin(jt.slice(j0, j1), errors, [0, errors.length], this.zero, joints.hole, unit)],
      command: of("command"), limits: limit("range_high"), "lower limit": limit("range_low"),
      "load torque": of("load_torque"), region: plans ? [] : of("region"), flank: plans ? of("flank") : [],
    };
    const { words, ...last } = plans ? PLANS : ACTS;
    this.units = [name, b ? "b" : small.name, command, "N m", ""];
    const y = [{ name: `angle, ${name}` }, { name: b ? "error, b" : `error, ${small.name} (b is not learned yet)`, min: -scale, max: scale }, { name: `command, ${command}` }, {}, { ...last, axisLabel: { formatter: (v) => words[v] ?? "" } }];
    const rows = this.narrow ? 2 : 5;
    this.points = this.curves.map(([name, row]) => (row < 2 ? data[name][row] : data[name]));
    chart.setOption({
      xAxis: Array.from({ length: rows }, () => ({ min: -this.window, max: 0 })),
      yAxis: y.slice(0, rows),
      series: this.curves.map(([name, row], k) => ({ id: `${name} ${row}`, data: this.points[k], ...(name === "error" && { markArea: { data: b ? BAND : [] } }), ...(name === "setpoint" && { markLine: { data: travel.map((end) => ({ yAxis: factor * end })) } }) })),
    }, { lazyUpdate: true });
  }

  draw() {
    const { axis, stopped = "", simulated, gap, angle } = this.options.facts();
    if (axis && axis !== this.axis) this.watch(axis);
    if (angle.name !== this.angle.name) this.layOut();
    if (!this.paused) this.fill();
    this.tooth.draw(this.joints, this.state, { b: this.b, simulated, gap, small: angle.small });
    this.tellStep();
    if (stopped !== told) tellStop((told = stopped)); // after the page was loaded anew, too
  }

  // The figures of the last step, beside its button, and of both over the curves.
  tellStep() {
    const now = performance.now();
    if (now - (this.toldStep || 0) < 250) return;
    this.toldStep = now;
    const { steps, b } = this, { small } = this.angle;
    steps.look(this.joints, this.state, (from, to) => this.errors(from, to), b, this.tooth);
    if (this.options.facts().stopped) steps.rattle = undefined; // at 0 V, and no time may pass
    steps.tell(b, small);
    const [result, more] = steps.words(b, small);
    document.getElementById("step-result").textContent = result;
    document.getElementById("step-more").textContent = more;
  }
}

export function start(options) {
  window.live = new Live(options);
}

let told = ""; // what the server says of a stop

function tellStop(text) {
  document.getElementById("stop-text").textContent = text;
}

export async function stop(axis) {
  tellStop("stopping ...");
  try {
    const answer = await fetch(`/stop?axis=${encodeURIComponent(axis)}`, { method: "POST" });
    tellStop(await answer.text());
  } catch {
    tellStop("The dashboard does not answer: stop the drive at the machine.");
  }
}
