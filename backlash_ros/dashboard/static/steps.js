// The last step of the reference and the one before it: their figures, and the load's way, to compare both.

export const SWING = 1; // s over which a swing is told, and for which a settled load has stayed
const HELD = 0.1; // s that references before and after a step stay, at least: faster ones are a path
const TOUCH = 0.45; // gaps from the middle, at least, where the teeth touch
const HEADS = ["rise, s", "settled, s", "over", "swing", "impacts"];

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

export class Steps {
  constructor(table) {
    const row = (name, cells) => `<tr><th scope="row">${name}</th>${cells.map((text) => `<td>${text}</td>`).join("")}</tr>`;
    const empty = HEADS.map(() => "");
    table.innerHTML = `<thead>${row("", HEADS)}</thead><tbody>${row("last step", empty)}${row("before it", empty)}</tbody>`;
    this.rows = [...table.rows].map((each) => [...each.cells].slice(1));
    this.forget();
  }

  forget() {
    this.last = this.before = this.ghost = undefined;
  }

  // Follow the last step while its reference holds. `errors(from, to)` returns setpoint minus load, rad, of samples.
  look(joints, state, errors, b, gap) {
    const found = this.find(state);
    if (found && joints.length && joints.of("time")[0] <= found.start) {
      if (this.last?.start !== found.start) [this.before, this.last] = [this.last, found];
      const step = this.last, from = joints.from(step.start), of = (name) => joints.of(name).slice(from);
      const error = errors(from, joints.length), time = of("time").map((each) => each - step.start);
      Object.assign(step, { time, error, load: of("load"), motor: of("motor"), rattles: state.last("rattle") > 0 });
      if (this.before && this.ghost?.of !== step.start) this.ghost = { of: step.start, ...this.laid(this.before) };
    }
    for (const step of [this.last, this.before]) if (step?.time.length) this.judge(step, b, gap);
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
    const rested = time[last] >= SWING && !Number.isNaN(load[last]), [low, high] = span(load, first(time, time[last] - SWING));
    step.swing = rested ? high - low : NaN;
    const band = b ? b / 4 : 0.02 * Math.abs(target - origin);
    let inside = last + 1;
    while (inside > 0 && Math.abs(ahead(inside - 1)) <= band) inside--;
    const never = inside > last || time[last] - time[inside] < SWING || (!b && step.rattles);
    step.settled = !rested ? NaN : never ? Infinity : time[inside];
    step.sample = time[last] / last;
    step.impacts = b && gap.sure ? 0 : NaN;
    const arrived = load.findIndex((_, k) => Math.abs(ahead(k)) < b), touch = (i) => Math.abs(motor[i] - load[i] - gap.middle) >= TOUCH * b;
    for (let i = arrived + 1; arrived >= 0 && i <= last; i++) if (touch(i) && !touch(i - 1)) step.impacts++;
  }

  // The way of a step, laid over the last one: it ends at the same target and comes from the same side.
  laid(step) {
    const { start, target, way } = this.last, sign = way * step.way;
    return {
      time: step.time.map((each) => start + each),
      load: step.load.map((each) => target + sign * (each - step.target)),
      error: step.error.map((each) => sign * each),
    };
  }

  tell(b, small) {
    const unit = b ? "b" : small.name, inUnit = (angle) => (b ? (angle / b).toFixed(2) : (angle * small.factor).toPrecision(3));
    const seconds = (value) => (value === Infinity ? "never" : value.toFixed(3));
    const text = (value, written) => (value === undefined || Number.isNaN(value) ? "\u2013" : written(value));
    [this.last, this.before].forEach((step, k) => {
      const cells = [[step?.rise, seconds], [step?.settled, seconds], [step?.over, inUnit], [step?.swing, inUnit], [step?.impacts, String]];
      cells.forEach(([value, written], i) => (this.rows[k + 1][i].textContent = text(value, written)));
    });
    for (const i of [2, 3]) this.rows[0][i].textContent = `${HEADS[i]}, ${unit}`;
  }
}
