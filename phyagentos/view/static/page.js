// Whether the page is fed, one cursor through timeline, plots, frames and tree, and what a person has opened; the rest is HTML.
const all = (selector) => document.querySelectorAll(selector), one = (selector) => document.querySelector(selector);
const say = (text, kind) => { const at = document.getElementById("connection"); if (at) { at.textContent = text; at.className = kind; } };
document.addEventListener("htmx:sseOpen", () => say("live", "live"));
document.addEventListener("htmx:sseError", () => say("connection lost, trying again", "lost"));
document.addEventListener("htmx:sendError", () => say("the server does not answer", "lost"));
document.addEventListener("htmx:beforeSwap", (event) => { if (event.detail.xhr.status === 422 || event.detail.xhr.status === 403) { event.detail.shouldSwap = true; event.detail.isError = false; } });
// The page's key stands in its address; this tab finds the way back to it from an address without.
sessionStorage.setItem("paos", `/${location.pathname.split("/")[1]}/`);

// The cursor stands at a share of the time in which the chosen session ran; null before it is used.
let share = null;
const chosen = () => { const bar = one("a.bar.chosen"); return bar && Number(bar.dataset.simTo) > Number(bar.dataset.simFrom) ? bar.dataset : null; };
const between = (from, to, at) => Number(from) + at * (Number(to) - Number(from));
const put = (line, percent) => { const is = percent >= 0 && percent <= 100; line.setAttribute("visibility", is ? "visible" : "hidden"); if (is) for (const end of ["x1", "x2"]) line.setAttribute(end, `${percent}%`); };
// What each curve of a plot says where the cursor is; a plot names the values at its edges, with their unit.
const courses = new WeakMap();
function readCourse(line) {
  const text = line.getAttribute("points");
  if (courses.get(line)?.text !== text) courses.set(line, { text, points: text.trim().split(/\s+/).map((point) => point.split(",").map(Number)) });
  return courses.get(line).points;
}
function tell(plot, at) {
  const { top, bottom } = plot.dataset, outputs = plot.closest("figure").querySelectorAll("output.at"), number = (text) => parseFloat(text.replace("−", "-"));
  const digits = (top.match(/\.(\d+)/) || ["", ""])[1].length, unit = top.replace(/^[−\-\d.]+/, "");
  plot.querySelectorAll("polyline").forEach((line, index) => {
    const points = readCourse(line), x = at * line.ownerSVGElement.viewBox.baseVal.width, next = points.findIndex((point) => point[0] >= x), output = outputs[index];
    if (!output || !points.length) return;
    const [b, a] = next < 0 ? [points.at(-1), points.at(-1)] : [points[next], points[Math.max(next - 1, 0)]], y = b[0] > a[0] ? between(a[1], b[1], (x - a[0]) / (b[0] - a[0])) : b[1];
    output.textContent = at < 0 || at > 1 ? "" : between(number(top), number(bottom), y / 100).toFixed(digits).replace("-", "−") + unit;
  });
}
function follow() {
  const bar = chosen();
  if (share === null || !bar) return;
  const sim = between(bar.simFrom, bar.simTo, share);
  all("svg.timeline > line.cursor").forEach((line) => put(line, between(bar.from, bar.to, share)));
  all("svg.plot").forEach((plot) => { const at = (sim - plot.dataset.from) / (plot.dataset.to - plot.dataset.from); put(plot.querySelector("line.cursor"), 100 * at); tell(plot, at); });
  all("input.cursor").forEach((slider) => { slider.value = 1000 * share; });
  all(".moment-at").forEach((words) => { words.textContent = `${sim.toFixed(2)} s simulated, ${new Date(between(bar.wallFrom, bar.wallTo, share)).toISOString().slice(11, 21)} UTC`; });
  const clock = new Date(between(bar.wallFrom, bar.wallTo, share)).toISOString().slice(11, 19), before = [...all(".log li[data-clock]")].filter((line) => line.dataset.clock <= clock);
  all(".log li.now").forEach((line) => line.classList.remove("now"));
  if (before.length) { const line = before[0], list = line.closest(".scroll"); line.classList.add("now"); list.scrollTop = line.offsetTop - list.offsetTop - list.clientHeight / 2; }
  direct({ time_s: sim });
  all(".tree li[data-at]").forEach((node) => node.classList.toggle("later", Number(node.dataset.at) > sim + 1e-6));
  const latest = new Map(), shown = [...all(isFlat ? ".frames figure" : ".frames figure:not([data-drawn])")];
  shown.sort((a, b) => a.dataset.at - b.dataset.at).forEach((figure) => { if (!latest.has(figure.dataset.camera) || Number(figure.dataset.at) <= sim + 1e-6) latest.set(figure.dataset.camera, figure); });
  all(".frames figure").forEach((figure) => figure.classList.toggle("now", latest.get(figure.dataset.camera) === figure));
  all(".frames").forEach((frames) => frames.classList.add("following"));
}
// The 3D scene stands at the cursor, and shows what is ticked: its frame, of another origin, is sent that.
const scene = { dark: matchMedia("(prefers-color-scheme: dark)").matches };
function direct(change) {
  Object.assign(scene, change);
  const frame = one("#panel-scene iframe");
  if (frame) frame.contentWindow.postMessage(scene, new URL(frame.src).origin);
}
document.addEventListener("load", (event) => { if (event.target.matches?.("#panel-scene iframe")) { document.documentElement.classList.remove("drawn"); direct({}); } }, true);
addEventListener("message", (event) => { if (event.data === "drawn" && event.source === one("#panel-scene iframe")?.contentWindow) document.documentElement.classList.add("drawn"); });
document.addEventListener("change", (event) => { const name = event.target.dataset?.scene; if (name) direct({ [name]: event.target.checked }); });
// Play moves the cursor through the session in its own time.
let playing = 0;
function play(starts) {
  clearInterval(playing);
  playing = 0;
  const bar = chosen(), button = one("#play");
  if (starts && bar) {
    if (share === null || share >= 1) share = 0;
    playing = setInterval(() => { const now = chosen(); if (!now) return play(false); move(share + 0.1 / (now.simTo - now.simFrom)); if (share >= 1) play(false); }, 100);
  }
  if (button) { button.textContent = playing ? "❚❚ Pause" : "▶ Play"; button.setAttribute("aria-pressed", String(Boolean(playing))); }
}
document.addEventListener("click", (event) => { if (event.target.id === "play") play(!playing); if (event.target.matches("#result .close")) one("#result").replaceChildren(); });
// Where nothing draws in 3D, pictures stand in place of the scene.
const canvas = document.createElement("canvas");
const graphics = canvas.getContext("webgl2") || canvas.getContext("webgl"), isFlat = !graphics;
// Where the processor draws, a quarter of the points keeps it in time with the run.
const drawer = graphics?.getParameter(graphics.getExtension("WEBGL_debug_renderer_info")?.UNMASKED_RENDERER_WEBGL ?? graphics.RENDERER);
if (/swiftshader|llvmpipe|software/i.test(drawer)) document.documentElement.classList.add("in-software");
if (isFlat) document.documentElement.classList.add("flat-only");
document.addEventListener("error", (event) => event.target.closest?.("figure[data-drawn]")?.remove(), true); // no graphics where the page is served
const move = (to) => { share = Math.min(Math.max(to, 0), 1); follow(); };
document.addEventListener("input", (event) => { if (event.target.matches("input.cursor")) move(event.target.value / 1000); });
for (const kind of ["pointerdown", "pointermove"]) document.addEventListener(kind, (event) => {
  const drawing = event.target.closest?.("svg.plot, svg.timeline"), bar = chosen();
  if (!drawing || !bar) return;
  const box = drawing.getBoundingClientRect(), at = (event.clientX - box.left) / box.width;
  if (drawing.matches("svg.plot")) move((between(drawing.dataset.from, drawing.dataset.to, at) - bar.simFrom) / (bar.simTo - bar.simFrom));
  else if (100 * at >= bar.from && 100 * at <= bar.to) move((100 * at - bar.from) / (bar.to - bar.from));
});
document.addEventListener("htmx:sseMessage", follow);
// Arrow keys go from bar to bar.
document.addEventListener("keydown", (event) => {
  const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key], here = event.target.closest?.("a.bar");
  if (!step || !here) return;
  event.preventDefault();
  const bars = [...all("a.bar")], next = bars[bars.indexOf(here) + step];
  if (next) { sessionStorage.setItem("paos-bar", "1"); location.assign(next.href.baseVal); }
});
if (sessionStorage.getItem("paos-bar")) { sessionStorage.removeItem("paos-bar"); one("a.bar.chosen")?.focus({ focusVisible: true }); }
// What moves comes as data, far more often than panels: a panel that was drawn before is brought up to it.
let beats = new Map();
function beat() {
  all("[data-beat]").forEach((each) => {
    const { beat: target, fact, session } = each.dataset, now = beats.get(target);
    if (!now || (session ?? now.session) !== now.session) return;
    if (fact === "path") each.querySelectorAll("li[data-path]").forEach((node) => node.classList.toggle("active", `${now.leaf}/`.startsWith(`${node.dataset.path}/`)));
    else if (each.textContent !== now[fact]) each.textContent = now[fact];
  });
}
const hear = ({ data }) => {
  beats = new Map(JSON.parse(data).map(([target, session, phase, leaf, time_s]) => [target, { session, phase, leaf, time: session && `${time_s.toFixed(1)} s simulated` }]));
  beat();
};
document.addEventListener("htmx:sseOpen", (event) => event.detail.source.addEventListener("pulse", hear)); // once, however often it opens
document.addEventListener("htmx:sseMessage", beat);
// What a person opens or closes stays so when its panel is renewed.
const touched = new WeakSet();
document.addEventListener("click", (event) => { const summary = event.target.closest?.("summary"); if (summary) touched.add(summary.parentElement); });
if (window.Idiomorph) Idiomorph.defaults.callbacks.beforeAttributeUpdated = (name, node) => !(name === "open" && touched.has(node));
