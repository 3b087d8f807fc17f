// Shows a banner while no news come from the server: what the page shows is old then. It is at the bottom, where it
// covers neither the title nor the stop button. The server changes data-pulse once a second. Time in which the page is
// hidden or too busy to look does not count, because it takes no news in either.
(() => {
  if (window.scancellConnection) return;
  window.scancellConnection = true;
  const PERIOD_MS = 500;
  const LOST_MS = 5000;
  let seen;
  let last = Date.now();
  let silent = 0;
  const banner = document.createElement("div");
  banner.setAttribute("role", "alert");
  banner.style.cssText =
    "position:fixed;bottom:0;left:0;right:0;z-index:10000;padding:0.5em;text-align:center;font-weight:600;" +
    "background:#b71c1c;color:#ffffff;pointer-events:none";
  banner.hidden = true;
  document.body.append(banner);
  setInterval(() => {
    const now = Date.now();
    silent += Math.min(now - last, 2 * PERIOD_MS);
    last = now;
    const pulse = document.querySelector("[data-pulse]")?.dataset.pulse;
    if (pulse !== seen || pulse === undefined || document.hidden) [seen, silent] = [pulse, 0];
    const lost = silent >= LOST_MS;
    banner.hidden = !lost;
    const seconds = Math.floor(silent / 1000);
    banner.textContent =
      `Connection lost, or this computer is too slow: no news from the server for ${seconds} s. The page shows an old state.`;
    const status = document.querySelector("[data-status]");
    if (status) status.style.opacity = lost ? "0.25" : "";
  }, PERIOD_MS);
})();
