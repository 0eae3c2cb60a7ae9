// Draws the charts of a report with the library and the data that the page holds. Nothing is loaded from elsewhere.

const unpacked = async (id) => {
  const bytes = Uint8Array.from(atob(document.getElementById(id).textContent), (letter) => letter.charCodeAt(0));
  const plain = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(plain).text();
};

const { palettes, charts } = JSON.parse(await unpacked("data"));
const library = URL.createObjectURL(new Blob([await unpacked("library")], { type: "text/javascript" }));
await import(library);
URL.revokeObjectURL(library);
const { echarts } = globalThis;

const dark = matchMedia("(prefers-color-scheme: dark)");
const LEGEND = 22, NAME = 18, BOTTOM = 40, LEFT = 64, RIGHT = 16, PAPER = 680;
const LETTER = 6, ROW = 12, ROWS = 8; // of the labels of marks: pixels, pixels, and how many fit in a panel
const font = "system-ui, sans-serif";
const minus = (text) => String(text).replace("-", "\u2212");
const brief = (value) => minus(Number(value.toPrecision(5)));

let printing = false;
const palette = () => palettes[printing ? "print" : dark.matches ? "dark" : "light"];

const sizes = () => (printing ? { panel: 54, space: 28 } : { panel: 120, space: 40 }); // two charts on a sheet
const height = (chart) => {
  const { panel, space } = sizes();
  return LEGEND + NAME + chart.panels.length * (panel + space) - space + BOTTOM;
};

// Labels of marks and spans: within the plot, each in the first row in which it meets no other.
const labelled = (chart, [from, to], wide) => {
  const ends = [];
  const all = [...chart.marks, ...chart.spans.map(([low, , text]) => [low, text, true])].sort(([a], [b]) => a - b);
  return all.map(([x, text, hidden]) => {
    const at = ((x - from) / (to - from)) * wide, length = LETTER * text.length + 6;
    const left = at + length > wide; // of its line
    const start = left ? at - length : at;
    let row = ends.findIndex((end) => end <= start);
    if (row < 0) row = ends.length;
    if (at >= 0 && at <= wide) ends[row] = start + length;
    return {
      xAxis: x, lineStyle: hidden ? { width: 0 } : {},
      label: { show: true, formatter: text, distance: -7 - ROW * (row % ROWS), align: left ? "right" : "left", padding: [0, 3] },
    };
  });
};

const marks = (chart, panel, labels, colour) => ({
  markLine: {
    silent: true, symbol: "none", animation: false,
    lineStyle: { color: colour.faint, type: "dotted", width: 1 },
    label: { color: colour.faint, fontSize: 10, position: "end", backgroundColor: `${colour.paper}cc` },
    data: [
      ...(labels || chart.marks.map(([x]) => ({ xAxis: x, label: { show: false } }))),
      ...panel.lines.map((y) => ({ yAxis: y, label: { show: false } })),
    ],
  },
  markArea: {
    silent: true, itemStyle: { color: colour.band, opacity: 0.7 },
    data: [
      ...chart.spans.map(([low, high]) => [{ xAxis: low }, { xAxis: high }]),
      ...panel.bands.map(([low, high]) => [{ yAxis: low }, { yAxis: high }]),
    ],
  },
});

const option = (chart, [from, to], wide) => {
  const colour = palette();
  const all = chart.panels.map((_, k) => k);
  const last = all.length - 1;
  const { panel: tall, space } = sizes();
  const text = { color: colour.ink, fontFamily: font };
  const series = chart.panels.flatMap((panel, k) => panel.series.map((line, at) => ({
    type: "line", name: line.name, xAxisIndex: k, yAxisIndex: k, symbol: "none", animation: false, silent: true,
    data: chart.times[line.times].map((x, n) => [x, line.values[n]]), connectNulls: false, clip: true,
    lineStyle: { width: line.dashed ? 1 : 1.4, type: line.dashed ? "dashed" : "solid", color: colour[line.colour] },
    itemStyle: { color: colour[line.colour] }, step: line.step ? "end" : false,
    ...(at === 0 ? marks(chart, panel, k === 0 && labelled(chart, [from, to], wide), colour) : {}),
  })));
  return {
    animation: false, backgroundColor: "transparent", textStyle: text,
    legend: {
      data: chart.panels.filter((panel) => panel.series.length > 1).flatMap((panel) => panel.series.map((line) => line.name)), top: 0, left: LEFT, itemWidth: 18, itemHeight: 8, textStyle: { ...text, fontSize: 11 }, icon: "roundRect" },
    grid: all.map((k) => ({ left: LEFT, right: RIGHT, top: LEGEND + NAME + k * (tall + space), height: tall })),
    xAxis: all.map((k) => ({
      type: "value", gridIndex: k, min: chart.from, max: chart.to, axisLine: { onZero: false, lineStyle: { color: colour.faint } },
      axisLabel: { show: k === last, color: colour.ink, formatter: brief, hideOverlap: true, showMinLabel: false, showMaxLabel: false },
      axisTick: { show: k === last }, splitLine: { lineStyle: { color: colour.line, width: 0.6 } },
      name: k === last ? chart.axis : "", nameLocation: "middle", nameGap: 24, nameTextStyle: text,
    })),
    yAxis: chart.panels.map((panel, k) => ({
      type: "value", gridIndex: k, scale: true, min: panel.low, max: panel.high, splitNumber: printing ? 2 : 3,
      axisLabel: { color: colour.ink, formatter: brief, showMinLabel: panel.low === null, showMaxLabel: panel.high === null && !printing },
      splitLine: { lineStyle: { color: colour.line, width: 0.6 } },
      name: panel.label, nameLocation: "end", nameGap: printing ? 5 : 10, nameTextStyle: { ...text, fontSize: 11, align: "left", padding: [0, 0, 0, -LEFT + 12] },
    })),
    axisPointer: { link: [{ xAxisIndex: "all" }], lineStyle: { color: colour.faint } },
    tooltip: {
      show: !printing, trigger: "axis", renderMode: "richText", confine: true, transitionDuration: 0,
      backgroundColor: colour.paper, borderColor: colour.line, textStyle: { ...text, fontSize: 11 },
      valueFormatter: (value) => (value === null || value === undefined ? "none" : brief(value)),
    },
    dataZoom: [{ type: "inside", xAxisIndex: all, startValue: from, endValue: to, filterMode: "filter", minValueSpan: 1e-4 }],
    series,
  };
};

class Chart {
  constructor(place, chart) {
    this.place = place;
    this.chart = chart;
    this.range = [chart.from, chart.to];
    this.plot = place.querySelector(".plot");
    this.output = place.querySelector("output");
    const moves = {
      in: ([low, high]) => [low + (high - low) / 4, high - (high - low) / 4],
      out: ([low, high]) => [low - (high - low) / 2, high + (high - low) / 2],
      left: ([low, high]) => [low - (high - low) / 4, high - (high - low) / 4],
      right: ([low, high]) => [low + (high - low) / 4, high + (high - low) / 4],
      all: () => [chart.from, chart.to],
    };
    for (const button of place.querySelectorAll("button")) {
      button.addEventListener("click", () => this.show(moves[button.dataset.zoom](this.range)));
    }
    this.fit();
    this.tell();
  }

  fit() {
    this.plot.style.height = `${height(this.chart)}px`;
  }

  draw() {
    if (this.drawn) return;
    this.drawn = echarts.init(this.plot, null, { renderer: "svg" });
    this.drawn.on("datazoom", () => {
      const { startValue, endValue } = this.drawn.getOption().dataZoom[0];
      this.range = [startValue, endValue];
      if (this.chart.marks.length + this.chart.spans.length) this.drawn.setOption({ series: [{ markLine: this.option().series[0].markLine }] });
      this.tell();
    });
    this.redraw();
    new ResizeObserver(() => printing || (this.drawn.resize(), this.redraw())).observe(this.plot);
  }

  option() {
    return option(this.chart, this.range, this.drawn.getWidth() - LEFT - RIGHT);
  }

  redraw() {
    this.drawn?.setOption(this.option(), { notMerge: true });
  }

  show([low, high]) {
    const { from, to } = this.chart;
    const width = Math.min(high - low, to - from);
    const start = Math.min(Math.max(low, from), to - width);
    this.draw();
    this.drawn.dispatchAction({ type: "dataZoom", startValue: start, endValue: start + width });
  }

  tell() {
    const digits = Math.max(0, Math.min(6, 3 - Math.floor(Math.log10(this.range[1] - this.range[0]))));
    const [low, high] = this.range.map((value) => minus((Math.round(value * 10 ** digits) / 10 ** digits + 0).toFixed(digits)));
    this.output.textContent = `${low} to ${high} s`;
  }

  paper(on) {
    this.fit();
    this.draw();
    this.drawn.resize(on ? { width: PAPER } : { width: "auto" });
    this.redraw();
    this.drawn.getZr().flush();
  }
}

const drawn = new Map(charts.map((chart) => {
  const place = document.getElementById(chart.id);
  return [place, new Chart(place, chart)];
}));
const seen = new IntersectionObserver(
  (entries) => entries.filter((entry) => entry.isIntersecting).forEach((entry) => drawn.get(entry.target).draw()),
  { rootMargin: "600px" },
);
for (const place of drawn.keys()) seen.observe(place);
dark.addEventListener("change", () => drawn.forEach((chart) => chart.redraw()));
let unfolded = []; // for paper alone
const print = (on) => {
  printing = on;
  if (on) unfolded = [...document.querySelectorAll("details:not([open])")];
  for (const each of unfolded) each.open = on;
  drawn.forEach((chart) => chart.paper(on));
};
addEventListener("beforeprint", () => print(true));
addEventListener("afterprint", () => print(false));
document.documentElement.dataset.charts = "ready";
