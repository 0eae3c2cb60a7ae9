// How a page looks, measured: texts that overlap, and texts whose contrast is below AA (WCAG 2.2, 1.4.3).
const numbers = (text) => {
  const part = text.match(/-?[\d.]+(e-?\d+)?/g).map(Number);
  const scale = text.startsWith("color(srgb") ? 1 : 255;
  return { rgb: part.slice(0, 3).map((each) => each / scale), alpha: part[3] ?? 1 };
};
const over = (top, below) => top.rgb.map((each, k) => top.alpha * each + (1 - top.alpha) * below[k]);
const background = (element) => {
  if (!element) return [1, 1, 1];
  const own = numbers(getComputedStyle(element).backgroundColor);
  return own.alpha === 1 ? own.rgb : over(own, background(element.parentElement));
};
const luminance = (rgb) => {
  const [r, g, b] = rgb.map((each) => (each <= 0.04045 ? each / 12.92 : ((each + 0.055) / 1.055) ** 2.4));
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
};
const contrast = (one, other) => {
  const [low, high] = [luminance(one), luminance(other)].sort((a, b) => a - b);
  return (high + 0.05) / (low + 0.05);
};
const clipped = (rect, element) => {
  let { left, top, right, bottom } = rect;
  for (let up = element; up; up = up.parentElement) {
    if (up !== element && getComputedStyle(up).overflow === "visible" && up.tagName !== "svg") continue;
    if (up === element && getComputedStyle(up).overflow === "visible") continue;
    const box = up.getBoundingClientRect();
    [left, top, right, bottom] = [Math.max(left, box.left), Math.max(top, box.top), Math.min(right, box.right), Math.min(bottom, box.bottom)];
  }
  return { left, top, right, bottom };
};
const texts = [];
const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
while (walker.nextNode()) {
  const node = walker.currentNode, element = node.parentElement;
  if (!node.data.trim() || !element.checkVisibility({ checkOpacity: true, checkVisibilityCSS: true })) continue;
  if (element.closest("script, style, title, [disabled], .q-icon, .unseen")) continue;
  const range = document.createRange();
  range.selectNodeContents(node);
  for (const rect of range.getClientRects()) {
    const seen = clipped(rect, element);
    if (seen.right - seen.left > 1 && seen.bottom - seen.top > 1) texts.push({ node, element, ...seen });
  }
}
const overlaps = [], pale = new Set();
texts.forEach((one, k) => texts.slice(k + 1).forEach((other) => {
  if (one.node === other.node) return;
  const width = Math.min(one.right, other.right) - Math.max(one.left, other.left);
  const height = Math.min(one.bottom, other.bottom) - Math.max(one.top, other.top);
  if (width > 1 && height > 3) overlaps.push(`${one.node.data.trim()} / ${other.node.data.trim()}`);
}));
for (const { node, element } of texts) {
  const style = getComputedStyle(element), drawn = element instanceof SVGElement;
  const behind = drawn
    ? [background(element.closest("section")), ...[...document.querySelectorAll(".solid")].map((each) => numbers(getComputedStyle(each).fill).rgb)]
    : [background(element)];
  const size = parseFloat(style.fontSize), large = size >= 24 || (size >= 18.66 && Number(style.fontWeight) >= 700);
  const least = Math.min(...behind.map((each) => contrast(over(numbers(drawn ? style.fill : style.color), each), each)));
  if (least < (large ? 3 : 4.5)) pale.add(`${node.data.trim()}: ${least.toFixed(2)}`);
}
return { overlaps, pale: [...pale], wide: document.documentElement.scrollWidth > innerWidth };
