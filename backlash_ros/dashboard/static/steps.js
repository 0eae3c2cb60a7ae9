// The last step of the reference and the one before it: their figures, and the load's way, to compare both.

export const SWING = 1; // s over which a swing is told, and for which a settled load has stayed
const HELD = 0.1; // s that references before and after a step stay, at least: faster ones are a path
const TOUCH = 0.45; // gaps from the middle, at least, where the teeth touch
const COUNTED = 2; // s after the load came near its target for which impacts are counted, and in which it should settle
const CALM = 5; // s without a rattle after which none is told any more
const HEADS = [
  ["rise, s", "from 10 to 90 % of the way"],
  ["settled, s", "from then on within b/4 of the target, for a second; while b is not known, within 2 % of the step"],
  ["over", "overshoot"],
  ["swing", "of the load in the last second, peak to peak"],
  ["impacts", "how often the teeth came to touch in the first 2 s near the target"],
];

// The first place in rising times that is not before `when`.
export function first(time, when) {
  let low = 0, high = time.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (time[middle] < when) low = middle + 1;
    else high = middle;
  }
  return low;
}

export function span(values, from) {
  let low = Infinity, high = -Infinity;
  for (let i = from; i < values.length; i++) {
    if (values[i] < low) low = values[i];
    if (values[i] > high) high = values[i];
  }
  return [low, high];
}

// A number of people: three digits, say, but never an exponent.
export function digits(value, count) {
  if (Math.abs(value) < 1e-6) return "0";
  return Math.abs(value) < 10 ** count ? value.toPrecision(count) : value.toFixed(0);
}

// An angle as small as the gap, in b where it is known.
export function inGaps(angle, b, small) {
  return b ? `${(angle / b).toFixed(2)} b` : `${digits(angle * small.factor, 3)} ${small.name}`;
}

export class Steps {
  constructor(table) {
    const row = (name, cells) => `<tr><th scope="row">${name}</th>${cells.map(([text, title]) => `<td title="${title}">${text}</td>`).join("")}</tr>`;
    const empty = HEADS.map(([, title]) => ["", title]);
    table.innerHTML = `<thead>${row("", HEADS)}</thead><tbody>${row("last step", empty)}${row("before it", empty)}</tbody>`;
    this.rows = [...table.rows].map((each) => [...each.cells].slice(1));
    this.forget();
  }

  forget() {
    this.last = this.before = this.ghost = this.rattle = undefined;
  }

  // Follow the last step while its reference holds. `errors(from, to)` returns setpoint minus load, rad, of samples.
  look(joints, state, errors, b, gap) {
    const found = this.find(state);
    for (const step of [this.last, this.before]) if (step) step.holds = false;
    if (found && joints.length && joints.of("time")[0] <= found.start) {
      if (this.last?.start !== found.start) [this.before, this.last] = [this.last, found];
      const step = this.last, from = joints.from(step.start), of = (name) => joints.of(name).slice(from);
      const error = errors(from, joints.length), time = of("time").map((each) => each - step.start);
      Object.assign(step, { time, error, load: of("load"), motor: of("motor"), rattles: state.last("rattle") > 0, holds: true });
      if (this.before && this.ghost?.of !== step.start) this.ghost = { of: step.start, ...this.laid(this.before) };
    }
    for (const step of [this.last, this.before]) if (step?.time.length) this.judge(step, b, gap);
    this.listen(joints, state);
  }

  // Notice a rattle: the controller tells one, while the setpoint stands. It may come and go, and is told until it stays away.
  listen(joints, state) {
    const now = state.last("time"), before = state.from(now - 2 * SWING), [lowest, highest] = span(state.of("setpoint"), before);
    const stands = lowest === highest && span(state.of("experiment"), before)[1] === 0;
    if (!stands || now > this.rattle?.until) this.rattle = undefined;
    const [low, high] = span(joints.of("load"), joints.from(joints.last("time") - SWING)), told = state.last("rattle");
    if (!stands || !(told > 0) || !(high - low > told / 2)) return;
    this.rattle = { until: now + CALM, swing: told };
  }

  // The step that holds now; none while the reference moves, an experiment runs, or no position is held.
  find(state) {
    const reference = state.of("reference"), time = state.of("time"), experiment = state.of("experiment");
    const newest = reference.length - 1, target = reference[newest];
    let at = newest;
    while (at > 0 && reference[at - 1] === target && !experiment[at]) at--;
    const origin = reference[at - 1];
    if (!Number.isFinite(target - origin) || target === origin || time[newest] - time[at] < HELD) return undefined;
    let rest = at - 1;
    while (rest > 0 && reference[rest - 1] === origin && time[at] - time[rest] < HELD) rest--;
    return time[at] - time[rest] < HELD ? undefined : { start: time[at], origin, target, way: Math.sign(target - origin) };
  }

  // Rise, settling, overshoot, swing and impacts, as in a report: s and rad; NaN for what is not known yet.
  judge(step, b, gap) {
    const { time, load, motor, origin, target, way } = step, last = time.length - 1;
    const ahead = (i) => way * (load[i] - target), begun = ahead(0);
    const passed = (share) => {
      const i = load.findIndex((_, k) => ahead(k) >= (1 - share) * begun);
      if (i < 1) return NaN;
      return time[i] - (time[i] - time[i - 1]) * ((ahead(i) - (1 - share) * begun) / (ahead(i) - ahead(i - 1)));
    };
    step.rise = passed(0.9) - passed(0.1);
    step.over = 0;
    for (let i = 0; i <= last; i++) if (ahead(i) > step.over) step.over = ahead(i);
    const [low, high] = span(load, first(time, time[last] - SWING)), band = b ? b / 4 : 0.02 * Math.abs(target - origin);
    let inside = -1, settled = Infinity; // the first time from which it stays: what happens later is no part of the step
    for (let i = 0; i <= last && settled === Infinity; i++) {
      if (!(Math.abs(ahead(i)) <= band)) inside = -1;
      else if (inside < 0) inside = i;
      if (inside >= 0 && time[i] - time[inside] >= SWING) settled = time[inside];
    }
    const near = load.findIndex((_, k) => ahead(k) >= 0.1 * begun), stands = time[last] >= SWING && high - low <= band;
    const over = settled < Infinity || stands || (near >= 0 && time[last] - time[near] >= (step.holds ? COUNTED : SWING)); // one that is left has no more time
    step.swing = over && !Number.isNaN(load[last]) ? high - low : NaN;
    step.settled = !over ? NaN : !b && step.rattles ? Infinity : settled;
    step.sample = time[last] / last;
    if (b && gap.sure && (step.holds || !(step.impacts >= 0))) step.impacts = this.impacts(step, ahead, b, gap.middle);
    step.impacts ??= NaN;
  }

  // How often the teeth came to touch, in the first time near the target. A tooth that was at both flanks says where they are.
  impacts({ time, load, motor }, ahead, b, known) {
    const arrived = load.findIndex((_, k) => Math.abs(ahead(k)) < b), last = arrived < 0 ? -1 : first(time, time[arrived] + COUNTED);
    const twist = motor.slice(0, last + 1).map((angle, i) => angle - load[i]), [low, high] = span(twist, Math.max(0, arrived));
    const middle = high - low > 2 * TOUCH * b ? (low + high) / 2 : known, touch = (i) => Math.abs(twist[i] - middle) >= TOUCH * b;
    let count = 0;
    for (let i = arrived + 1; i < twist.length; i++) if (touch(i) && !touch(i - 1)) count++;
    return count;
  }

  // The way of a step, laid over the last one: it ends at the same target and comes from the same side.
  laid(step) {
    const { start, origin, target, way } = this.last, sign = way * step.way, far = 1.2 * Math.abs(target - origin);
    const near = (angle) => (Math.abs(angle) <= far ? angle : NaN); // a longer step does not stretch the picture of this one
    return {
      time: step.time.map((each) => start + each),
      load: step.load.map((each) => target + near(sign * (each - step.target))),
      error: step.error.map((each) => sign * each),
    };
  }

  // What the last step shows, beside its button, and what it is measured by.
  words(b, small) {
    const step = this.last;
    if (this.rattle) return [`rattles by ${inGaps(this.rattle.swing, b, small)}`, "peak to peak, while it should stand"];
    if (!step) return ["no step yet", "would show whether the load rattles"];
    if (Number.isNaN(step.settled)) return ["moves", ""];
    const result = step.settled === Infinity ? "did not settle" : `settled in ${step.settled.toFixed(3)} \u00b1 ${step.sample.toFixed(3)} s`;
    return [result, step.holds ? `swing ${inGaps(step.swing, b, small)} in the last second` : "in the last step"];
  }

  tell(b, small) {
    const unit = b ? "b" : small.name, inUnit = (angle) => inGaps(angle, b, small).split(" ")[0];
    const seconds = (value) => (value === Infinity ? "never" : value.toFixed(3));
    const text = (value, written) => (value === undefined || Number.isNaN(value) ? "\u2013" : written(value));
    [this.last, this.before].forEach((step, k) => {
      const cells = [[step?.rise, seconds], [step?.settled, seconds], [step?.over, inUnit], [step?.swing, inUnit], [step?.impacts, String]];
      cells.forEach(([value, written], i) => (this.rows[k + 1][i].textContent = text(value, written)));
    });
    for (const i of [2, 3]) this.rows[0][i].textContent = `${HEADS[i][0]}, ${unit}`;
  }
}
