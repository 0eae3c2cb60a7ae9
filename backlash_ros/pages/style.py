"""How a page looks: light, dark, on a phone and on A4."""

from backlash_ros.simulation.colours import DARK, LIGHT, PRINT


def _variables(colours: dict[str, str]) -> str:
    return " ".join(f"--{name}: {colour};" for name, colour in colours.items())


STYLE = (
    f":root {{ color-scheme: light dark; {_variables(LIGHT)} }}\n"
    f"@media (prefers-color-scheme: dark) {{ :root {{ {_variables(DARK)} }} }}\n"
    """
* { box-sizing: border-box; }
body {
  margin: 0 auto; padding: 1.5rem 1rem 3rem; max-width: 64rem; background: var(--paper); color: var(--ink);
  font: 1rem/1.45 system-ui, sans-serif; overflow-wrap: anywhere;
}
h1 { font-size: 1.6rem; line-height: 1.2; margin: 0; }
h2 { font-size: 1.15rem; margin: 2rem 0 .5rem; break-after: avoid; }
p { margin: .5rem 0; max-width: 46rem; }
.under { color: var(--faint); margin-top: .2rem; }
.verdict { border-left: .3rem solid var(--good); padding: .1rem 0 .1rem .8rem; margin: 1rem 0; font-size: 1.1rem; }
.verdict.bad { border-color: var(--bad); }
table { border-collapse: collapse; width: 100%; font-size: .92rem; }
th, td { text-align: left; vertical-align: top; padding: .35rem .8rem .35rem 0; border-bottom: 1px solid var(--line); }
thead th { color: var(--faint); font-weight: 600; }
tbody th { font-weight: 400; width: 26%; }
tr { break-inside: avoid; }
tbody tr:first-child { break-after: avoid; }
td.number { white-space: nowrap; font-variant-numeric: tabular-nums; }
td.why { color: var(--bad); }
.symbol { color: var(--faint); font-size: .85em; white-space: nowrap; }
.pictures { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 24rem), 1fr)); gap: 1.5rem; }
.pictures > :first-child:nth-last-child(n + 3) { grid-row: span 2; }
figure { margin: 0; break-inside: avoid; }
figure svg { width: 100%; height: auto; display: block; max-width: 36rem; }
figure svg * { stroke-linejoin: round; stroke-linecap: butt; }
figcaption { font-size: .88rem; color: var(--faint); margin-top: .4rem; }
code, pre { font: .88em/1.5 ui-monospace, monospace; }
pre { white-space: pre-wrap; border: 1px solid var(--line); padding: .6rem .8rem; margin: .5rem 0; }
@media screen and (max-width: 40rem) {
  thead { position: absolute; left: -200vw; }
  table, tbody, tr, th, td { display: block; border: 0; padding: 0; }
  tr { border-bottom: 1px solid var(--line); padding: .5rem 0; }
  tbody th { font-weight: 600; width: auto; }
  td[data-name]::before { content: attr(data-name) ": "; }
  .symbol { font-weight: 400; }
  td.number { white-space: normal; }
}
@page { size: A4; margin: 14mm; }
@media print {
  html { font-size: 8.5pt; }
  body { padding: 0; max-width: none; }
  p { max-width: none; }
  h2 { margin-top: 1.2rem; }
  h2 + p { break-after: avoid; }
  th, td { padding: .2rem .6rem .2rem 0; }
  .pictures { grid-template-columns: 1fr 1fr; }
  .verdict, .pictures, th, td { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
}
"""
    f"@media print {{ :root {{ color-scheme: light; {_variables(PRINT)} }} }}\n"
)
