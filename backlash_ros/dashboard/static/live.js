// Curves, drawn from the samples that the server sends; and the stop.

import { Tooth } from "./tooth.js";

const KEPT = 65; // s of samples that are kept
const FRAME = 50; // ms between two pictures
const POINTS = 600; // places along a curve; each shows the least and the largest value there
const SWING = 1; // s over which the load's swing is told

class Table {
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
    const time = this.values[0];
    let low = 0, high = time.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (time[middle] < when) low = middle + 1;
      else high = middle;
    }
    return low;
  }
}

function thin(time, values, from, to, zero) {
  const step = Math.max(1, Math.floor((to - from) / POINTS));
  const points = [];
  for (let i = from; i < to; i += step) {
    let least = i, largest = i;
    for (let k = i + 1; k < Math.min(to, i + step); k++) {
      if (values[k] < values[least] || Number.isNaN(values[least])) least = k;
      if (values[k] > values[largest] || Number.isNaN(values[largest])) largest = k;
    }
    const ends = least < largest ? [least, largest] : [largest, least];
    for (const end of new Set(ends)) points.push([time[end] - zero, Number.isNaN(values[end]) ? null : values[end]]);
  }
  return points;
}

function niceLimit(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return power * [1, 1.5, 2, 3, 5, 7.5, 10].find((step) => step * power >= value);
}

function span(values, from) {
  let low = Infinity, high = -Infinity;
  for (let i = from; i < values.length; i++) {
    if (values[i] < low) low = values[i];
    if (values[i] > high) high = values[i];
  }
  return [low, high];
}

const ROWS = [["angle, rad", 25], ["error, b", 25], ["command", 17], ["load torque, N m", 15], ["region, flank", 12]];
const NARROW = 600; // px; a narrower chart has the first two rows alone
const CURVES = [
  ["load", 0, "load"], ["motor through the gear", 0, "motor"], ["setpoint", 0, "faint", "dashed"],
  ["error", 1, "load"],
  ["command", 2, "command"], ["limits", 2, "faint", "dotted"], ["lower limit", 2, "faint", "dotted"],
  ["load torque", 3, "torque"],
  ["region", 4, "command"], ["flank", 4, "motor", "dashed"],
];
const LEAST_SPAN = [1e-3, 0, 0.1, 1e-3, 0]; // of an axis by its row, so that no rounding noise fills it

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
    this.forget();
    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.layOut());
    new ResizeObserver(() => this.narrow !== this.chart.getWidth() < NARROW && this.layOut()).observe(this.chart.getDom());
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
    const rows = this.narrow ? ROWS.slice(0, 2) : ROWS;
    const whole = rows.reduce((sum, [, height]) => sum + height, 0);
    const text = colour("ink"), line = colour("line");
    const axis = { type: "value", axisLine: { onZero: false, lineStyle: { color: line } }, splitLine: { lineStyle: { color: line } } };
    let top = this.narrow ? 9 : 5;
    const grids = [], x = [], y = [];
    rows.forEach(([name, part], i) => {
      const last = i === rows.length - 1, height = ((99 - (this.narrow ? 9 : 5)) * part) / whole;
      grids.push({ left: 64, right: 16, top: `${top}%`, height: `${height - (this.narrow ? 10 : 5)}%`, outerBoundsMode: "none" });
      top += height;
      x.push({ ...axis, gridIndex: i, axisLabel: { show: last, color: text, formatter: (v) => `${v.toFixed(1)} s` }, axisTick: { show: last } });
      y.push({
        ...axis, gridIndex: i, name, nameLocation: "end", nameGap: 6, scale: true, splitNumber: 3,
        nameTextStyle: { color: text, align: "left", padding: [0, 0, 0, -56] },
        axisLabel: { color: text, showMaxLabel: false, hideOverlap: true, formatter: (v) => `${+v.toPrecision(3)}` },
        min: ({ min, max }) => (max - min < LEAST_SPAN[i] ? (min + max - LEAST_SPAN[i]) / 2 : null),
        max: ({ min, max }) => (max - min < LEAST_SPAN[i] ? (min + max + LEAST_SPAN[i]) / 2 : null),
      });
    });
    if (!this.narrow) Object.assign(y[4], { min: -1, max: 3, interval: 1 });
    this.curves = CURVES.filter(([, row]) => row < rows.length);
    const series = this.curves.map(([name, row, hue, type = "solid"]) => ({
      name, type: "line", xAxisIndex: row, yAxisIndex: row, showSymbol: false, animation: false, data: [], step: row === 4 ? "end" : false,
      lineStyle: { width: type === "dotted" ? 1 : 1.4, color: colour(hue), type }, itemStyle: { color: colour(hue) },
    }));
    const band = series.find(({ name }) => name === "error");
    band.markArea = { silent: true, itemStyle: { color: colour("good"), opacity: 0.13 }, data: [[{ yAxis: -0.5 }, { yAxis: 0.5 }]] };
    this.chart.setOption({
      animation: false,
      aria: { enabled: true, label: { description: "Angles, error, command, load torque and region over time, as they are now." } },
      backgroundColor: "transparent",
      textStyle: { color: text, fontFamily: "system-ui, sans-serif" },
      grid: grids, xAxis: x, yAxis: y, series,
      tooltip: { trigger: "axis", confine: true, valueFormatter: (v) => (typeof v === "number" ? v.toPrecision(4) : "") },
      axisPointer: { link: [{ xAxisIndex: "all" }] },
      legend: { type: "scroll", top: 0, left: 96, right: 8, textStyle: { color: text }, data: ["setpoint", "load", "motor through the gear"], itemHeight: 8 },
      dataZoom: [{ type: "inside", xAxisIndex: rows.map((_, i) => i), filterMode: "none" }],
    }, { replaceMerge: ["grid", "xAxis", "yAxis", "series", "dataZoom"] });
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

  fill() {
    const { joints, state, chart } = this;
    if (!this.paused || this.zero === undefined) {
      const newest = Math.max(joints.length ? joints.last("time") : -Infinity, state.length ? state.last("time") : -Infinity);
      if (!Number.isFinite(newest)) return;
      this.newest = newest;
      this.zero = newest;
    }
    const { start, end } = this.paused ? chart.getOption().dataZoom[0] : { start: 0, end: 100 };
    const first = this.newest - this.window;
    const left = first + (this.window * start) / 100, right = first + (this.window * end) / 100;
    const [j0, j1] = [Math.max(0, joints.from(left) - 1), Math.min(joints.length, joints.from(right) + 1)];
    const [s0, s1] = [Math.max(0, state.from(left) - 1), Math.min(state.length, state.from(right) + 1)];
    const jt = joints.of("time"), st = state.of("time");
    const b = this.b, unit = b || 1e-3;
    const load = joints.of("load"), setpoint = state.of("setpoint"), offset = state.of("offset");
    const error = new Array(load.length);
    let k = Math.max(0, s0 - 1);
    for (let i = j0; i < j1; i++) {
      while (k + 1 < st.length && st[k + 1] <= jt[i]) k++;
      error[i] = st.length && st[k] <= jt[i] ? (setpoint[k] + offset[k] - load[i]) / unit : NaN;
    }
    this.error = error;
    // The scale is that of the last second, so that a rattle is seen beside the step that came before it.
    const [low, high] = span(error, Math.max(j0, joints.from(joints.last("time") - SWING)));
    const half = b ? 0.75 : 1;
    const scale = niceLimit(Math.max(half, Number.isFinite(low) ? 1.3 * Math.max(-low, high) : half));
    const of = (name) => thin(st, state.of(name), s0, s1, this.zero);
    const limit = (name) => (this.options.facts().unit === "V" ? of(name) : []); // limits are told in V
    const joint = (values) => thin(jt, values, j0, j1, this.zero);
    const data = {
      load: joint(load), "motor through the gear": joint(joints.of("motor")), setpoint: of("setpoint"), error: joint(error),
      command: of("command"), limits: limit("range_high"), "lower limit": limit("range_low"),
      "load torque": of("load_torque"), region: of("region"), flank: of("flank"),
    };
    const y = [{}, { name: b ? "error, b" : "error, mrad (b is not learned yet)", min: -scale, max: scale }, { name: `command, ${this.options.facts().unit}` }, {}, {}];
    const rows = this.narrow ? 2 : 5;
    chart.setOption({
      xAxis: Array.from({ length: rows }, () => ({ min: -this.window, max: 0 })),
      yAxis: y.slice(0, rows),
      series: this.curves.map(([name]) => ({ name, data: data[name] })),
    }, { lazyUpdate: true });
  }

  draw() {
    const { axis, stopped = "", simulated, gap } = this.options.facts();
    if (axis && axis !== this.axis) this.watch(axis);
    if (!this.paused) this.fill();
    this.tooth.draw(this.joints, this.state, { b: this.b, simulated, gap });
    this.tellStep();
    if (stopped !== told) tellStop((told = stopped)); // after the page was loaded anew, too
  }

  // The figures of the last step, beside its button.
  tellStep() {
    const now = performance.now();
    if (now - (this.toldStep || 0) < 250) return;
    this.toldStep = now;
    const [result, more] = this.stepText();
    document.getElementById("step-result").textContent = result;
    document.getElementById("step-more").textContent = more;
  }
  stepText() {
    const { joints, state } = this;
    const reference = state.of("reference"), time = state.of("time"), jt = joints.of("time"), load = joints.of("load");
    let k = reference.length - 1;
    const target = reference[k];
    while (k > 0 && reference[k - 1] === target && !state.of("experiment")[k]) k--;
    if (!(k > 0) || !Number.isFinite(target - reference[k - 1]) || reference[k - 1] === target || !joints.length) return ["no step yet", ""];
    const from = joints.from(time[k]), last = joints.length - 1;
    if (jt[last] - time[k] < SWING || Number.isNaN(load[last])) return ["moves", ""];
    const inWords = (angle) => (this.b ? `${(angle / this.b).toFixed(2)} b` : `${(1e3 * angle).toFixed(1)} mrad`);
    const [low, high] = span(load, Math.max(from, joints.from(jt[last] - SWING)));
    const swing = `swing ${inWords(high - low)} in the last second`;
    if (state.last("rattle") > 0) return [`rattles by ${inWords(state.last("rattle"))}`, swing];
    const band = this.b ? this.b / 4 : 0.02 * Math.abs(target - reference[k - 1]);
    let outside = last;
    while (outside >= from && Math.abs(load[outside] - target) <= band) outside--;
    if (jt[last] - jt[outside] < SWING) return ["not settled", swing];
    const sure = (jt[last] - jt[from]) / (last - from); // one sample
    return [`settled in ${Math.max(0, jt[outside] - time[k]).toFixed(3)} \u00b1 ${sure.toFixed(3)} s`, swing];
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
