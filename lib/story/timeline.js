// SPDX-License-Identifier: Apache-2.0
"use strict";
const RUN = 0, SWITCH = 1;
const PALETTE = ["#E69F00","#56B4E9","#009E73","#F0E442","#5B8FF9","#D55E00","#CC79A7","#B8B8B8","#8FD175","#C9A0FF","#FFB3A7","#7FD6D0"];
const $ = id => document.getElementById(id);
const NS = "http://www.w3.org/2000/svg";
function el(parent, name, attributes, text) {
  const e = document.createElementNS(NS, name);
  for (const k in attributes) e.setAttribute(k, attributes[k]);
  if (text !== undefined) e.textContent = text;
  parent.appendChild(e);
  return e;
}
function html(parent, name, text, cls) {
  const e = document.createElement(name);
  if (text !== undefined) e.textContent = text;
  if (cls) e.className = cls;
  parent.appendChild(e);
  return e;
}
const ms = us => us === null ? "\u2013" : (us / 1000).toFixed(2);  // a dash: nothing was measured
const modules = [...new Set(DATA.panels.flatMap(p => p.measured.map(b => b[2])))].sort();
const colour = m => PALETTE[modules.indexOf(m) % PALETTE.length];
const longest = Math.max(1000, ...DATA.panels.map(p => Math.max(p.shownLatency, ...p.measured.map(b => b[4]))));
let view = [0, longest * 1.02], picked = null;

$("title").textContent = DATA.title;
$("note").textContent = DATA.note;

// ---- the table: the answer in one look
const worst = Math.max(1, ...DATA.panels.map(p => p.p99));
const head = html($("table"), "tr");
for (const t of ["policy, end-to-end latency in ms", "p99", "", "p50", "max"]) html(head, "th", t);
for (const p of DATA.panels) {
  const row = html($("table"), "tr");
  html(row, "td", p.name);
  html(row, "td", ms(p.p99)).style.fontWeight = 650;
  html(html(row, "td", undefined, "bar"), "div").style.width = (100 * p.p99 / worst) + "%";
  for (const v of [p.p50, p.max]) html(row, "td", ms(v));
}

// ---- the legend: click a module to single it out
for (const m of modules) {
  const b = html($("legend"), "button");
  b.setAttribute("aria-pressed", "false");
  html(b, "i").style.background = colour(m);
  b.appendChild(document.createTextNode(m));
  b.onclick = () => {
    picked = picked === m ? null : m;
    for (const o of $("legend").querySelectorAll("button")) o.setAttribute("aria-pressed", String(o === b && picked !== null));
    draw();
  };
}
for (const [text, style] of [["measured", "background:var(--dim)"],
                             ["switching", "background:repeating-linear-gradient(45deg,var(--dim) 0 2px,transparent 2px 5px)"]]) {
  const k = html($("legend"), "span", undefined, "key");
  html(k, "i").style.cssText = style;
  k.appendChild(document.createTextNode(text));
}

// ---- a lane for each of several bars that overlap on one row
function lanes(bars) {
  const ends = [];
  const lane = new Map();
  const names = new Map();  // all bars of one XNode stay in one lane
  for (const b of [...bars].sort((a, c) => a[3] - c[3])) {
    if (names.has(b[1])) { const n = names.get(b[1]); lane.set(b, n); ends[n] = Math.max(ends[n], b[4]); continue; }
    const last = Math.max(...bars.filter(o => o[1] === b[1]).map(o => o[4]));
    let n = ends.findIndex(e => e <= b[3] + 60);
    if (n < 0) { n = ends.length; ends.push(0); }
    ends[n] = last;
    names.set(b[1], n);
    lane.set(b, n);
  }
  return [lane, Math.max(1, ends.length)];
}

function tip(event, text) {
  const t = $("tip");
  t.textContent = text;
  t.style.display = "block";
  t.style.left = Math.min(innerWidth - t.offsetWidth - 8, event.clientX + 14) + "px";
  t.style.top = Math.min(innerHeight - t.offsetHeight - 8, event.clientY + 14) + "px";
}
const hide = () => { $("tip").style.display = "none"; };

const W = 1200, LEFT = 74, RIGHT = 16, LANE = 19;
const x = us => LEFT + (us - view[0]) / (view[1] - view[0]) * (W - LEFT - RIGHT);
function clipped(b) { return [Math.max(b[3], view[0]), Math.min(b[4], view[1])]; }

function gantt(card, p) {
  const rows = p.rows.map((name, i) => {
    const measured = p.measured.filter(b => b[0] === i);
    const [lane, n] = lanes(measured);
    return { name, measured, lane, height: n * LANE + 8 };
  });
  const H = rows.reduce((s, r) => s + r.height, 0) + 26;
  const svg = el(card, "svg", { viewBox: `0 0 ${W} ${H}`, role: "img", "aria-label": "schedule under " + p.name });
  const pattern = el(el(svg, "defs", {}), "pattern", { id: "h" + p.id, width: 5, height: 5, patternTransform: "rotate(45)", patternUnits: "userSpaceOnUse" });
  el(pattern, "rect", { width: 2, height: 5, fill: "var(--dim)" });
  const span = view[1] - view[0];
  const step = [100, 200, 500, 1000, 2000, 5000, 10000, 20000, 50000, 100000, 1000000].find(s => span / s <= 14) || 1e7;
  let y = 4;
  for (const r of rows) {
    el(svg, "rect", { class: "lane", x: LEFT, y, width: W - LEFT - RIGHT, height: r.height - 4, rx: 3 });
    el(svg, "text", { x: 4, y: y + r.height / 2 + 2 }, r.name);
    y += r.height;
  }
  for (let t = Math.ceil(view[0] / step) * step; t <= view[1]; t += step) {
    el(svg, "line", { class: "grid", x1: x(t), x2: x(t), y1: 0, y2: H - 18 });
    el(svg, "text", { class: "dim", x: x(t), y: H - 5, "text-anchor": "middle" }, t / 1000 + (t + step > view[1] ? " ms" : ""));
  }
  y = 4;
  for (const r of rows) {
    for (const b of r.measured) {
      const [from, to] = clipped(b);
      if (to <= from) continue;
      const yb = y + 2 + r.lane.get(b) * LANE, w = Math.max(1, x(to) - x(from));
      const faded = picked && picked !== b[2] ? " faded" : "";
      const fill = b[5] === SWITCH ? `url(#h${p.id})` : colour(b[2]);
      const bar = el(svg, "rect", { class: "bar" + faded, x: x(from), y: yb, width: w, height: LANE - 3, rx: 2, fill });
      const what = b[5] === SWITCH ? "is being switched" : "runs";
      bar.onmousemove = e => tip(e, `${b[1]} (${b[2]}) ${what} on ${r.name}\n${ms(b[3])} \u2013 ${ms(b[4])} ms, ${ms(b[4] - b[3])} ms`);
      bar.onmouseleave = hide;
      const label = b[1].length * 5.6 + 8 < w ? b[1] : (b[2].length * 6 + 6 < w ? b[2] : "");
      if (b[5] === RUN && label) el(svg, "text", { class: "label" + faded, x: x(from) + 4, y: yb + 11.5 }, label);
    }
    y += r.height;
  }
  if (p.shownLatency <= view[1] && p.shownLatency >= view[0]) {
    el(svg, "line", { class: "end", x1: x(p.shownLatency), x2: x(p.shownLatency), y1: 0, y2: H - 18 });
    const right = x(p.shownLatency) > W - 110;
    el(svg, "text", { class: "latency", x: x(p.shownLatency) + (right ? -5 : 5), y: 12, "text-anchor": right ? "end" : "start" }, ms(p.shownLatency) + " ms");
  }
}

/// Every activation's latency as a dot, on the same time axis.
function strip(card, p) {
  const svg = el(card, "svg", { viewBox: `0 0 ${W} 30`, role: "img", "aria-label": "latencies under " + p.name });
  el(svg, "text", { class: "dim", x: 4, y: 19 }, "latencies");
  p.latencies.forEach((l, i) => {
    if (l < view[0] || l > view[1]) return;
    const dot = el(svg, "circle", { cx: x(l), cy: 6 + (i * 7) % 19, r: 1.8, fill: "var(--accent)", "fill-opacity": 0.5 });
    dot.onmousemove = e => tip(e, `activation ${i}: ${ms(l)} ms`);
    dot.onmouseleave = hide;
  });
}

function draw() {
  $("panels").replaceChildren();
  for (const p of DATA.panels) {
    const card = html($("panels"), "div", undefined, "card");
    const h = html(card, "div", undefined, "head");
    html(h, "h2", p.name);
    if (p.latencies.length === 0) {
      html(h, "span", "no result is in the trace", "dim");
      continue;
    }
    // The number beside the heading is the one that the chart shows.
    html(h, "span", ms(p.shownLatency) + " ms", "big");
    html(h, "span", `the slowest of ${p.latencies.length} is shown, activation ${p.shown}; p50 ${ms(p.p50)}, p99 ${ms(p.p99)}, max ${ms(p.max)}`, "dim");
    gantt(card, p);
    strip(card, p);
  }
}
function zoom(factor, centre) {
  const c = centre === undefined ? (view[0] + view[1]) / 2 : centre;
  const span = Math.min(longest * 1.02, Math.max(200, (view[1] - view[0]) * factor));
  const from = Math.max(0, Math.min(longest * 1.02 - span, c - (c - view[0]) / (view[1] - view[0]) * span));
  view = [from, from + span];
  draw();
}
// Ctrl and the wheel, or two fingers on a touchpad: what is under the pointer stays there.
$("panels").addEventListener("wheel", e => {
  const svg = e.target.closest("svg");
  if (!e.ctrlKey || !svg) return;
  e.preventDefault();
  const box = svg.getBoundingClientRect();
  const at = ((e.clientX - box.left) / box.width * W - LEFT) / (W - LEFT - RIGHT);
  hide();
  zoom(e.deltaY < 0 ? 0.7 : 1 / 0.7, view[0] + Math.min(1, Math.max(0, at)) * (view[1] - view[0]));
}, { passive: false });
$("in").onclick = () => zoom(0.6);
$("out").onclick = () => zoom(1 / 0.6);
$("all").onclick = () => { view = [0, longest * 1.02]; draw(); };
addEventListener("keydown", e => {
  const pan = (view[1] - view[0]) * 0.2;
  if (e.key === "+") zoom(0.6);
  else if (e.key === "-") zoom(1 / 0.6);
  else if (e.key === "0") { view = [0, longest * 1.02]; draw(); }
  else if (e.key === "ArrowLeft" || e.key === "ArrowRight") {
    const d = e.key === "ArrowLeft" ? -Math.min(pan, view[0]) : Math.min(pan, longest * 1.02 - view[1]);
    view = [view[0] + d, view[1] + d];
    draw();
  }
});
draw();
