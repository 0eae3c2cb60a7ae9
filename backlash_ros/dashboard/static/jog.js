// Jogging: the load moves for as long as one holds a button, by pointer or by key. Whatever ends that ends the motion.

const BEAT = 50; // ms between two looks whether the button is there, as it was pressed
const SHORT = 300; // ms that a click lasts at most: it is not held
const READ = 10000; // ms that a text stays, unless the next press comes sooner

const KEYS = { " ": 0, Enter: 0, ArrowLeft: -1, ArrowRight: 1 }; // way of a key; 0: that of its button

let hand; // the thread that tells the server
let held; // the button that is held, and whether by a key
let said; // timer of the text

const button = (element) => element?.closest?.("[data-jog]");

function say(text) {
  const place = document.getElementById("jog-text");
  place.textContent = text;
  clearTimeout(said);
  said = setTimeout(() => (place.textContent = ""), READ);
}

function release() {
  if (!held) return;
  hand.postMessage("let go");
  clearInterval(held.beat);
  held.jogs.classList.remove("held");
  if (performance.now() - held.since < SHORT) say("Hold it down: the load moves until you let go.");
  held = undefined;
}

function press(jogs, byKey) {
  const axis = window.facts?.axis, share = document.getElementById("jog-share").value;
  if (!axis || document.hidden) return;
  say("");
  const asked = new URLSearchParams({ axis, way: jogs.dataset.jog, share });
  hand.postMessage(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/jog?${asked}`);
  const look = () => {
    const there = jogs.isConnected && jogs.checkVisibility() && !jogs.disabled && window.facts.axis === axis;
    if (there) hand.postMessage("held");
    else release();
  };
  held = { jogs, byKey, since: performance.now(), beat: setInterval(look, BEAT) };
  jogs.classList.add("held");
}

function onKey(event) {
  if (!event.repeat) release(); // another key
  const at = button(event.target);
  if (!at || !(event.key in KEYS) || event.ctrlKey || event.altKey || event.metaKey) return;
  event.preventDefault();
  event.stopImmediatePropagation();
  if (event.repeat) return; // a key that was held before, for something else
  const way = KEYS[event.key];
  press(way ? document.querySelector(`[data-jog="${way}"]`) : at, true);
}

function onPress(event) {
  release(); // a second finger, or another button
  const at = button(event.target);
  if (!at || event.button !== 0 || !event.isPrimary) return;
  if (event.target.hasPointerCapture(event.pointerId)) event.target.releasePointerCapture(event.pointerId); // a finger may leave, too
  press(at, false);
}

export function watch() {
  hand = new Worker(new URL("./hand.js", import.meta.url));
  hand.onmessage = ({ data }) => {
    release();
    say(data);
  };
  const on = (kind, act, where = document) => where.addEventListener(kind, act, true);
  on("pointerdown", onPress);
  on("pointerout", ({ relatedTarget }) => held && !held.byKey && button(relatedTarget) !== held.jogs && release());
  on("focusout", ({ target, relatedTarget }) => {
    const from = button(target), leaves = from && from !== button(relatedTarget); // not to another part of the same button
    if (held && leaves && (held.byKey || from === held.jogs)) release();
  });
  for (const kind of ["pointerup", "pointercancel", "keyup", "visibilitychange", "freeze", "dragstart"]) on(kind, release);
  for (const kind of ["blur", "pagehide"]) on(kind, ({ target }) => (target === window || target === document) && release(), window);
  on("keydown", onKey);
  on("contextmenu", (event) => button(event.target) && event.preventDefault()); // of a long press
}
