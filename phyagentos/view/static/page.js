// Says whether the page is fed; almost everything else is HTML.
const say = (text, kind) => { const at = document.getElementById("connection"); if (at) { at.textContent = text; at.className = kind; } };
document.addEventListener("htmx:sseOpen", () => say("live", "live"));
document.addEventListener("htmx:sseError", () => say("connection lost, trying again", "lost"));
document.addEventListener("htmx:sendError", () => say("the server does not answer", "lost"));
document.addEventListener("htmx:beforeSwap", (event) => { if (event.detail.xhr.status === 422 || event.detail.xhr.status === 403) { event.detail.shouldSwap = true; event.detail.isError = false; } });
// The client of the 3D scene looks for its server again only where it has the focus: here it is one panel of several.
document.addEventListener("load", (event) => { if (event.target.tagName === "IFRAME" && event.target.contentDocument) event.target.contentDocument.hasFocus = () => !document.hidden; }, true);
