// Says whether the page is fed; everything else is HTML.
const say = (text, kind) => { const at = document.getElementById("connection"); if (at) { at.textContent = text; at.className = kind; } };
document.addEventListener("htmx:sseOpen", () => say("live", "live"));
document.addEventListener("htmx:sseError", () => say("connection lost, trying again", "lost"));
document.addEventListener("htmx:sendError", () => say("the server does not answer", "lost"));
document.addEventListener("htmx:beforeSwap", (event) => { if (event.detail.xhr.status === 422 || event.detail.xhr.status === 403) { event.detail.shouldSwap = true; event.detail.isError = false; } });
