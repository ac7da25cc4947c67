// Says whether the page is fed; almost everything else is HTML.
const say = (text, kind) => { const at = document.getElementById("connection"); if (at) { at.textContent = text; at.className = kind; } };
document.addEventListener("htmx:sseOpen", () => say("live", "live"));
document.addEventListener("htmx:sseError", () => say("connection lost, trying again", "lost"));
document.addEventListener("htmx:sendError", () => say("the server does not answer", "lost"));
document.addEventListener("htmx:beforeSwap", (event) => { if (event.detail.xhr.status === 422 || event.detail.xhr.status === 403) { event.detail.shouldSwap = true; event.detail.isError = false; } });
// The page's key stands in its address; this tab finds the way back to it from an address without.
sessionStorage.setItem("paos", `/${location.pathname.split("/")[1]}/`);
