"""What does the report look like? Neutral greys around the pictures, because a tint there changes how light is judged.

Colours of lines and bars follow Okabe and Ito's colour-blind safe palette, darkened on white and lightened on black
until each stands out from the page at least 3 : 1. Light and dark follow the reader's system.
"""

STYLE = """
:root {
  color-scheme: light dark; --paper: #f4f4f4; --card: #ffffff; --ink: #1c1c1c; --quiet: #5a5a5a;
  --rule: #d9d9d9; --grid: #e6e6e6; --shade: #e9e9e9; --accent: #0067a8; --warn: #a33c00; --k0: #0072b2;
  --k1: #c44f00; --k2: #00805f; --k3: #b04a88; --k4: #9c6a00; --k5: #4a4a4a; --b0: #0072b2; --b1: #3a94ca;
  --b2: #00805f; --b3: #b98a00; --b4: #c44f00; --b5: #7a2f60;
}
@media (prefers-color-scheme: dark) {
  :root {
    --paper: #161616; --card: #1f1f1f; --ink: #ececec; --quiet: #a8a8a8; --rule: #3a3a3a; --grid: #2e2e2e;
    --shade: #303030; --accent: #6cbcf0; --warn: #f0a06a; --k0: #56b4e9; --k1: #f07a3a; --k2: #2bc59a;
    --k3: #e08fbf; --k4: #e6c029; --k5: #d0d0d0; --b0: #2f8fd0; --b1: #8fd0f5; --b2: #1fa57f; --b3: #e6c029;
    --b4: #f07a3a; --b5: #f5c8e4;
  }
}
* { box-sizing: border-box; }
html { -webkit-text-size-adjust: 100%; }
body {
  margin: 0; background: var(--paper); color: var(--ink);
  font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", "DejaVu Sans", sans-serif;
}
.page { max-width: 1280px; margin: 0 auto; padding: 40px 32px 64px; }
h1 {
  font-size: 40px; line-height: 1.15; margin: 4px 0 12px; font-weight: 650; letter-spacing: -0.01em;
  overflow-wrap: anywhere;
}
h2 { font-size: 24px; line-height: 1.25; margin: 56px 0 16px; font-weight: 650; }
h3 { font-size: 17px; line-height: 1.35; margin: 0 0 4px; font-weight: 650; }
p { margin: 0 0 12px; max-width: 78ch; }
code, pre {
  font-family: ui-monospace, "SF Mono", "Cascadia Mono", Consolas, "DejaVu Sans Mono", monospace;
  font-size: 0.92em;
}
code { overflow-wrap: anywhere; }
a { color: var(--accent); }
.eyebrow, .quiet { color: var(--quiet); }
.eyebrow {
  margin: 0; font-size: 15px; display: flex; flex-wrap: wrap; gap: 4px 24px; justify-content: space-between;
  max-width: none;
}
.eyebrow nav { display: flex; gap: 20px; }
.quiet { font-size: 14.5px; font-weight: 400; }
.lead { font-size: 21px; line-height: 1.45; max-width: 62ch; }
.warning { border-left: 4px solid var(--warn); padding: 8px 14px; background: var(--card); max-width: none; }
.figures {
  display: grid; grid-template-columns: repeat(6, 1fr); gap: 1px; margin: 28px 0 0; background: var(--rule);
  border: 1px solid var(--rule); border-radius: 8px; overflow: hidden;
}
.figures div {
  background: var(--card); padding: 16px 18px; display: flex; flex-direction: column-reverse;
  justify-content: flex-end;
}
.figures dd { margin: 0; font-size: 27px; line-height: 1.2; font-weight: 600; font-variant-numeric: tabular-nums; }
.figures dt { font-size: 14px; line-height: 1.35; color: var(--quiet); margin-top: 4px; }
.viewer { position: relative; }
.viewer > input { position: fixed; top: 0; left: 0; opacity: 0; pointer-events: none; }
.scrubber {
  position: sticky; top: 0; z-index: 5; display: flex; flex-wrap: wrap; gap: 4px; align-items: stretch;
  padding: 10px 0; background: var(--paper); touch-action: pan-y; user-select: none; -webkit-user-select: none;
}
.scrubber-name { align-self: end; padding: 0 8px 6px 0; font-size: 14.5px; color: var(--quiet); }
.scrubber label {
  flex: 1 1 38px; max-width: 84px; padding: 3px 4px 5px; border-radius: 6px; background: var(--card);
  text-align: center; cursor: pointer; font-variant-numeric: tabular-nums; font-size: 15px; line-height: 1.3;
  border: 1px solid var(--rule);
}
.scrubber .icons { display: flex; justify-content: center; gap: 1px; height: 15px; }
.icon { width: 13px; height: 13px; vertical-align: -2px; fill: currentColor; flex: none; }
.moment { display: none; padding-top: 12px; }
.moments { margin-bottom: 24px; }
.moment > p { max-width: none; }
.strip {
  display: grid; grid-template-columns: repeat(auto-fill, minmax(272px, 1fr)); gap: 24px 16px; margin-top: 14px;
}
figure { margin: 0; min-width: 0; }
.strip img { outline: 1px solid var(--rule); outline-offset: -1px; }
.strip img, .missing { display: block; width: 100%; height: auto; border-radius: 4px; background: var(--shade); }
.missing {
  aspect-ratio: 4 / 3; display: grid; place-items: center; padding: 16px; text-align: center; font-size: 14.5px;
  color: var(--quiet); border: 1px dashed var(--quiet);
}
.strip figcaption { padding-top: 8px; font-size: 15px; line-height: 1.4; }
.strip strong { font-weight: 650; margin-right: 8px; }
.meaning { display: block; font-size: 14px; color: var(--quiet); }
.figure-number { font-size: 14px; font-variant-numeric: tabular-nums; white-space: nowrap; }
.wipe { margin: 40px 0 24px; max-width: 880px; }
.wipe-names { display: flex; justify-content: space-between; gap: 12px; margin: 8px 0; flex-wrap: wrap; }
.wipe-names label { font-size: 14.5px; color: var(--quiet); }
select, button {
  font: inherit; font-size: 15px; color: var(--ink); background: var(--card); border: 1px solid var(--quiet);
  border-radius: 6px; padding: 4px 10px; max-width: 100%;
}
.stage {
  --w: 4; --h: 3; --cut: 50%; position: relative; aspect-ratio: var(--w) / var(--h);
  width: min(100%, calc(82vh * var(--w) / var(--h))); overflow: hidden; border-radius: 4px;
  background: var(--shade); cursor: ew-resize; touch-action: pan-y; user-select: none;
  -webkit-user-select: none;
}
.stage img { position: absolute; inset: 0; width: 100%; height: 100%; pointer-events: none; }
.stage .over { clip-path: inset(0 calc(100% - var(--cut)) 0 0); }
.stage .under { clip-path: inset(0 0 0 var(--cut)); }
.absent { position: absolute; inset: auto 0 12px; text-align: center; font-size: 14.5px; color: var(--quiet); }
.divider {
  position: absolute; top: 0; bottom: 0; left: var(--cut); width: 2px; margin-left: -1px; background: #fff;
  box-shadow: 0 0 0 1px rgba(0,0,0,.6);
}
.divider::after {
  content: ""; position: absolute; top: 50%; left: -12px; width: 26px; height: 26px; margin-top: -13px;
  border-radius: 50%; background: #fff; box-shadow: 0 0 0 1px rgba(0,0,0,.6);
}
.divider::before {
  content: ""; position: absolute; z-index: 1; top: 50%; left: -6px; width: 14px; height: 10px;
  margin-top: -5px; background: linear-gradient(#222, #222) center / 2px 100% no-repeat;
  clip-path: polygon(0 50%, 5px 0, 5px 100%, 0 50%, 14px 50%, 9px 0, 9px 100%, 14px 50%); background: #222;
}
.divider:focus-visible { outline: none; }
.divider:focus-visible::after { box-shadow: 0 0 0 3px var(--accent); }
[hidden] { display: none !important; }
.legend {
  list-style: none; margin: 0; padding: 0; display: flex; flex-wrap: wrap; gap: 4px 20px; font-size: 14.5px;
}
.legend li { display: flex; align-items: center; gap: 7px; min-width: 0; overflow-wrap: anywhere; }
.legend .icon { color: var(--quiet); }
.line-icon { width: 34px; height: 12px; flex: none; }
.swatch, .shade-icon { width: 13px; height: 13px; border-radius: 2px; background: var(--c); flex: none; }
.shade-icon { background: var(--shade); border: 1px solid var(--quiet); }
.key { font-variant-numeric: tabular-nums; color: var(--quiet); font-weight: 600; }
.plots {
  display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 480px), 1fr)); gap: 20px;
  margin-top: 18px;
}
.plot {
  background: var(--card); border: 1px solid var(--rule); border-radius: 8px; padding: 16px 18px 14px;
  display: flex; flex-direction: column;
}
.plot figcaption p { font-size: 14.5px; color: var(--quiet); line-height: 1.4; }
.plot .legend { margin: 0 0 0 50px; font-size: 14px; }
.axes { margin: 18px 0 44px 50px; width: calc(100% - 58px); }
.plot:last-child:nth-child(odd) { grid-column: 1 / -1; }
.lanes { margin: 0 0 10px 50px; width: calc(100% - 58px); }
.axes, .axes svg, .lanes, .lanes svg { overflow: visible; flex: none; display: block; }
.axes text, .lanes text { fill: var(--quiet); font-size: 12.5px; font-variant-numeric: tabular-nums; }
.tick-y { text-anchor: end; dominant-baseline: central; }
.tick-x, .empty { text-anchor: middle; }
.axis-x { text-anchor: end; }
.axes .empty { font-size: 15px; }
.grid { stroke: var(--grid); }
.base { stroke: var(--quiet); }
.shade { fill: var(--shade); }
.column { fill: transparent; }
.column:hover { fill: var(--ink); fill-opacity: .08; }
.line, .limit {
  fill: none; stroke: var(--c); stroke-width: 1.8; stroke-linejoin: round; vector-effect: non-scaling-stroke;
}
.limit { stroke: var(--ink); stroke-width: 1.4; stroke-dasharray: 2 3; }
.stem { stroke: var(--quiet); }
.dot { fill: var(--c); }
.mark { fill: var(--c); stroke: var(--card); stroke-width: 1.2; }
.bar { fill: var(--c); }
.cut { fill: var(--ink); }
.axes text.cut { fill: var(--ink); dominant-baseline: central; }
.now { stroke: var(--ink); stroke-opacity: .55; stroke-dasharray: 5 4; }
.now:not([x1]) { display: none; }
.s0 { --c: var(--k0); }
.s1 { --c: var(--k1); }
.s2 { --c: var(--k2); }
.s3 { --c: var(--k3); }
.s4 { --c: var(--k4); }
.s5 { --c: var(--k5); }
.line.d1 { stroke-dasharray: 7 4; }
.line.d2 { stroke-dasharray: 2 4; }
.b0 { --c: var(--b0); }
.b1 { --c: var(--b1); }
.b2 { --c: var(--b2); }
.b3 { --c: var(--b3); }
.b4 { --c: var(--b4); }
.b5 { --c: var(--b5); }
.block {
  background: var(--card); border: 1px solid var(--rule); border-radius: 8px; padding: 18px 20px;
  margin-bottom: 20px;
}
.block > :last-child { margin-bottom: 0; }
.block ul { margin: 6px 0 0; padding-left: 20px; max-width: 90ch; }
.facts { columns: 2 440px; column-gap: 20px; }
.facts .block { break-inside: avoid; }
.scroll { overflow-x: auto; margin: 8px 0 12px; }
table { border-collapse: collapse; width: 100%; font-size: 15px; line-height: 1.4; }
th, td {
  text-align: right; padding: 8px 12px; border-top: 1px solid var(--rule); vertical-align: baseline;
  font-variant-numeric: tabular-nums;
}
thead th { border-top: 0; font-weight: 600; vertical-align: bottom; }
th:first-child, .words td, .words th, .pairs td { text-align: left; }
th:first-child, .pairs td { padding-left: 0; }
tbody th { font-weight: 500; }
td:last-child, th:last-child { padding-right: 0; }
.way { display: block; font-size: 13.5px; font-weight: 400; color: var(--quiet); }
.comparison .way, .probes th:first-child { white-space: normal; }
.comparison td, .coefficients td, .coefficients th { white-space: nowrap; }
.comparison thead .way { white-space: nowrap; }
.comparison tbody th { min-width: 200px; }
.best { font-weight: 700; color: var(--accent); }
.pairs { table-layout: fixed; }
.pairs th { width: 45%; color: var(--quiet); font-weight: 400; }
.pairs th, .pairs td { overflow-wrap: anywhere; padding-top: 5px; padding-bottom: 5px; }
.state { font-weight: 600; }
th code { overflow-wrap: break-word; }
.answer code { white-space: nowrap; }
.probes td:nth-child(2) { white-space: nowrap; }
.chain { margin-top: 18px; }
.chain ol { margin: 8px 0 0; padding-left: 28px; }
details { margin-top: 10px; }
summary { cursor: pointer; overflow-wrap: anywhere; }
pre {
  white-space: pre-wrap; overflow-wrap: anywhere; background: var(--paper); padding: 12px 14px;
  border-radius: 6px; margin: 8px 0 12px;
}
@media (max-width: 1150px) {
  .comparison thead .way { white-space: normal; }
  .comparison tbody th { min-width: 150px; }
  .figures { grid-template-columns: repeat(3, 1fr); }
}
@media (max-width: 700px) {
  .page { padding: 24px 16px 48px; }
  h1 { font-size: 31px; }
  .lead { font-size: 18.5px; }
  h2 { margin-top: 44px; }
  .figures { grid-template-columns: 1fr 1fr; }
  .figures div { padding: 12px 14px; }
  .figures dd { font-size: 22px; }
  .strip { grid-template-columns: 1fr 1fr; gap: 18px 12px; }
  .plot, .block { padding: 14px; }
  .stacking, .stacking tbody, .stacking tr, .stacking th, .stacking td { display: block; }
  .stacking thead { display: none; }
  .stacking tr { padding: 12px 0; border-top: 1px solid var(--rule); }
  .stacking th, .stacking td { border: 0; padding: 3px 0; text-align: left; }
  .stacking td { display: flex; justify-content: space-between; gap: 16px; white-space: normal; text-align: right; }
  .stacking td::before {
    content: attr(data-column); color: var(--quiet); text-align: left; flex: 0 0 auto; max-width: 62%;
  }
  .pairs th { width: 52%; }
  .wipe-names { display: grid; grid-template-columns: 1fr 1fr; }
  .wipe-names label { display: grid; gap: 2px; min-width: 0; }
}
@media print {
  .scrubber, .wipe, nav, button { display: none; }
  .plot, .block, figure { break-inside: avoid; }
}
"""
