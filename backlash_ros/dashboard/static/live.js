// Curves and the tooth in its gap, drawn from the samples that the server sends; and the stop.

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

const COLORS = { light: ["#0b5fa5", "#b3541e", "#5c6670", "#7b3fa0", "#2f7d32"], dark: ["#6cb6f5", "#f0a36b", "#a9b4be", "#c79be8", "#81c784"] };

class Live {
  constructor(options) {
    this.options = options;
    this.window = 10;
    this.paused = false;
    this.forget();
    this.drawn = 0;
    this.chart = options.chart;
    this.chart.on("datazoom", () => this.onZoom());
    this.dark = window.matchMedia("(prefers-color-scheme: dark)");
    this.dark.addEventListener("change", () => this.layOut());
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
    this.low = this.high = this.strongest = undefined; // of the twist and of the force
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
    const dark = this.dark.matches;
    const colors = COLORS[dark ? "dark" : "light"];
    const text = dark ? "#e3e6e8" : "#20262b";
    const line = dark ? "#3d464e" : "#d5dade";
    const rows = [
      ["angle, rad", 25], ["error, b", 25], ["command", 17], ["load torque, N m", 15], ["region, flank", 12],
    ];
    let top = 4;
    const grids = [], x = [], y = [];
    rows.forEach(([name, height], i) => {
      grids.push({ left: 64, right: 16, top: `${top}%`, height: `${height - 5}%` });
      top += height;
      x.push({ type: "value", gridIndex: i, axisLine: { onZero: false, lineStyle: { color: line } }, axisLabel: { show: i === rows.length - 1, color: text, formatter: (v) => v.toFixed(1) }, axisTick: { show: i === rows.length - 1 }, splitLine: { lineStyle: { color: line } }, name: i === rows.length - 1 ? "s" : "", nameTextStyle: { color: text } });
      y.push({ type: "value", gridIndex: i, axisLine: { onZero: false, lineStyle: { color: line } }, name, nameLocation: "end", nameGap: 6, nameTextStyle: { color: text, align: "left", padding: [0, 0, 0, -56] }, scale: true, axisLabel: { color: text, showMaxLabel: false, hideOverlap: true }, splitLine: { lineStyle: { color: line } }, splitNumber: 3 });
    });
    Object.assign(y[4], { min: -1, max: 3, interval: 1 });
    const curve = (name, grid, color, more = {}) => ({ name, type: "line", xAxisIndex: grid, yAxisIndex: grid, showSymbol: false, animation: false, data: [], lineStyle: { width: 1.4, color, ...more.lineStyle }, itemStyle: { color }, step: more.step });
    this.curves = ["load", "motor through the gear", "setpoint", "error", "command", "limits", "lower limit", "load torque", "region", "flank"];
    this.chart.setOption({
      animation: false,
      aria: { enabled: true, label: { description: "Angles, error, command, load torque and region over time, as they are now." } },
      backgroundColor: "transparent",
      textStyle: { color: text, fontFamily: "system-ui, sans-serif" },
      grid: grids, xAxis: x, yAxis: y,
      tooltip: { trigger: "axis", confine: true, valueFormatter: (v) => (typeof v === "number" ? v.toPrecision(4) : "") },
      axisPointer: { link: [{ xAxisIndex: "all" }] },
      legend: { type: "scroll", top: 0, left: 96, right: 8, textStyle: { color: text }, data: ["setpoint", "load", "motor through the gear", "region", "flank"], itemHeight: 8 },
      dataZoom: [{ type: "inside", xAxisIndex: [0, 1, 2, 3, 4], filterMode: "none" }],
      series: [
        curve("load", 0, colors[0]), curve("motor through the gear", 0, colors[1]), curve("setpoint", 0, colors[2], { lineStyle: { type: "dashed" } }),
        { ...curve("error", 1, colors[0]), markArea: { silent: true, itemStyle: { color: dark ? "#81c78433" : "#2f7d3222" }, data: [[{ yAxis: -0.5 }, { yAxis: 0.5 }]] } },
        curve("command", 2, colors[3]), curve("limits", 2, colors[2], { lineStyle: { type: "dotted" } }), curve("lower limit", 2, colors[2], { lineStyle: { type: "dotted" } }),
        curve("load torque", 3, colors[4]),
        curve("region", 4, colors[3], { step: "end" }), curve("flank", 4, colors[1], { step: "end", lineStyle: { type: "dashed" } }),
      ],
    }, { replaceMerge: ["series"] });
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
    const data = [joint(load), joint(joints.of("motor")), of("setpoint"), joint(error), of("command"), limit("range_high"), limit("range_low"), of("load_torque"), of("region"), of("flank")];
    chart.setOption({
      xAxis: Array.from({ length: 5 }, () => ({ min: -this.window, max: 0 })),
      yAxis: [{}, { name: b ? "error, b" : "error, mrad (b is not learned yet)", min: -scale, max: scale }, { name: `command, ${this.options.facts().unit}` }, {}, {}],
      series: this.curves.map((name, i) => ({ name, data: data[i] })),
    }, { lazyUpdate: true });
  }

  draw() {
    const axis = this.options.facts().axis;
    if (axis && axis !== this.axis) this.watch(axis);
    if (!this.paused) this.fill();
    this.tooth();
  }

  // The tooth of the motor's gear in the gap of the load's, magnified.
  tooth() {
    const { joints, state } = this;
    const svg = document.getElementById("tooth");
    if (!svg || !joints.length) return;
    const motor = joints.of("motor"), load = joints.of("load");
    const now = joints.length - 1, recent = joints.from(joints.last("time") - SWING);
    const twist = motor[now] - load[now];
    if (Number.isNaN(twist)) return; // with one encoder nobody sees it
    if (!(this.low <= twist)) this.low = twist;
    if (!(this.high >= twist)) this.high = twist;
    for (let i = recent; i <= now; i++) {
      const value = motor[i] - load[i];
      if (value < this.low) this.low = value;
      if (value > this.high) this.high = value;
    }
    const b = this.b;
    const width = b || this.options.facts().gap || Math.max(this.high - this.low, 1e-6);
    // Where the middle of the gap is: between the flanks where both were seen, else as near to 0 as what was seen allows.
    const [least, most] = [this.high - width / 2, this.low + width / 2];
    const middle = least > most ? (least + most) / 2 : Math.min(Math.max(0, least), most);
    const place = Math.max(-0.62, Math.min(0.62, (twist - middle) / width));
    const setpoint = state.last("setpoint");
    const swing = span(load, recent);
    const off = Number.isFinite(setpoint) ? (load[now] - setpoint) / width : 0;
    const px = 90; // of the gap
    const clip = (value) => Math.max(-1.2, Math.min(1.2, value));
    const x = 230 + clip(off) * px;
    svg.querySelector("#gap").setAttribute("transform", `translate(${x} 0)`);
    svg.querySelector("#pinion").setAttribute("transform", `translate(${x + place * px} 0)`);
    const torque = joints.last("gear_torque");
    const simulated = this.options.facts().simulated && Number.isFinite(torque);
    const touches = simulated ? Math.sign(torque) * (Math.abs(torque) > 1e-4) : Math.abs(place) > 0.49 ? Math.sign(place) : 0;
    svg.querySelector("#right").classList.toggle("touched", touches > 0);
    svg.querySelector("#left").classList.toggle("touched", touches < 0);
    const arrow = svg.querySelector("#force");
    arrow.style.display = simulated && touches ? "" : "none";
    if (simulated && touches) {
      this.strongest = Math.max((this.strongest || 0) * 0.999, Math.abs(torque), 1e-3);
      const length = 12 + (48 * Math.abs(torque)) / this.strongest;
      const at = x + place * px + touches * 32;
      arrow.setAttribute("d", `M${at} 62 h${touches * length} m${-touches * 8} -5 l${touches * 8} 5 l${-touches * 8} 5`);
    }
    const bar = svg.querySelector("#swing");
    const ends = swing.map((value) => 230 + clip((value - setpoint) / width) * px);
    bar.setAttribute("x", Math.min(...ends) || 0);
    bar.setAttribute("width", Math.max(2, Math.abs(ends[1] - ends[0]) || 2));
    const told = swing[1] - swing[0];
    const size = b ? `${(told / b).toFixed(2)} b` : `${(1e3 * told).toFixed(2)} mrad`;
    const side = touches > 0 ? "on the flank that drives the load forward" : touches < 0 ? "on the flank that holds the load back" : "between the flanks";
    const text = `The load moved by ${size} in the last second. The tooth is ${side}${simulated && touches ? `, with ${Math.abs(torque).toPrecision(2)} N m` : ""}.`;
    if (performance.now() - (this.told || 0) > 250) {
      this.told = performance.now();
      document.getElementById("swing-text").textContent = text;
    }
  }
}

export function start(options) {
  window.live = new Live(options);
}

export async function stop(axis) {
  const told = document.getElementById("stop-text");
  told.textContent = "stopping ...";
  try {
    const answer = await fetch(`/stop?axis=${encodeURIComponent(axis)}`, { method: "POST" });
    told.textContent = await answer.text();
  } catch {
    told.textContent = "The dashboard does not answer: stop the drive at the machine.";
  }
}
