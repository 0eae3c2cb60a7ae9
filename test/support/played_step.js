// What the page says of a step that is played to it: arguments are load(t) and rattle(t) of s since the step, and how long.
const { Steps } = await import("/static/steps.js"), { Table } = await import("/static/live.js");
const [load, rattle, reference] = [...arguments].slice(0, 3).map((body) => new Function("t", `return ${body}`)), b = 0.02;
const joints = new Table(["time", "motor", "load"]), state = new Table(["time", "reference", "setpoint", "experiment", "rattle"]);
const steps = new Steps(document.createElement("table")), told = [];
for (let k = -50; k < 1000; k++) {
  const t = 0.01 * k;
  joints.add([10 + t, load(t), load(t)]);
  state.add([10 + t, reference(t), reference(t), 0, rattle(t)]);
  if (k % 10) continue;
  steps.look(joints, state, (from, to) => Array(to - from).fill(NaN), b, { sure: true, middle: 0 });
  const words = steps.words(b, { name: "mrad", factor: 1000 });
  if (words[0] !== told.at(-1)?.[0]) told.push(words);
}
return told;
