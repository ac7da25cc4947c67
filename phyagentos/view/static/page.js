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
function follow() {
  const bar = chosen();
  if (share === null || !bar) return;
  const sim = between(bar.simFrom, bar.simTo, share);
  all("svg.timeline > line.cursor").forEach((line) => put(line, between(bar.from, bar.to, share)));
  all("svg.plot").forEach((plot) => put(plot.querySelector("line.cursor"), 100 * (sim - plot.dataset.from) / (plot.dataset.to - plot.dataset.from)));
  const slider = one("#moment"), words = one("#moment-at");
  if (slider) slider.value = 1000 * share;
  if (words) words.textContent = `${sim.toFixed(2)} s simulated, ${new Date(between(bar.wallFrom, bar.wallTo, share)).toISOString().slice(11, 21)} UTC`;
  all(".tree li[data-at]").forEach((node) => node.classList.toggle("later", Number(node.dataset.at) > sim + 1e-6));
  const latest = new Map();
  [...all(".frames figure")].sort((a, b) => a.dataset.at - b.dataset.at).forEach((figure) => { if (!latest.has(figure.dataset.camera) || Number(figure.dataset.at) <= sim + 1e-6) latest.set(figure.dataset.camera, figure); });
  all(".frames figure").forEach((figure) => figure.classList.toggle("now", latest.get(figure.dataset.camera) === figure));
  all(".frames").forEach((frames) => frames.classList.add("following"));
}
const move = (to) => { share = Math.min(Math.max(to, 0), 1); follow(); };
document.addEventListener("input", (event) => { if (event.target.id === "moment") move(event.target.value / 1000); });
document.addEventListener("pointermove", (event) => {
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
// What a person opens or closes stays so when its panel is renewed.
const touched = new WeakSet();
document.addEventListener("click", (event) => { const summary = event.target.closest?.("summary"); if (summary) touched.add(summary.parentElement); });
if (window.Idiomorph) Idiomorph.defaults.callbacks.beforeAttributeUpdated = (name, node) => !(name === "open" && touched.has(node));
