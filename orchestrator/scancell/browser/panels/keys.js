// Keys of the workspace: Escape stops the robot wherever the focus is; J and K hold the jog buttons while they are down.
// It runs as an inline handler, where a bare addEventListener would be that of its element.
(() => {
  if (window.scancellKeys) return;
  window.scancellKeys = true;
  const HOLDS = { j: "Hold to jog -", k: "Hold to jog +" };
  const held = new Map();
  const find = (label) =>
    [...document.querySelectorAll("button")].find((one) => one.textContent.trim() === label && !one.disabled);
  const send = (button, kind) =>
    button.dispatchEvent(new PointerEvent(kind, { bubbles: true, button: 0, pointerId: 1 }));
  const release = (key) => {
    const button = held.get(key);
    held.delete(key);
    if (button) send(button, "pointerup");
  };
  window.addEventListener(
    "keydown",
    (event) => {
      const key = event.key.toLowerCase();
      if (key === "escape") find("Stop")?.click();
      const typing = ["INPUT", "TEXTAREA", "SELECT"].includes(event.target.tagName);
      const button = typing || event.repeat || held.has(key) || !HOLDS[key] ? undefined : find(HOLDS[key]);
      if (!button) return;
      held.set(key, button);
      send(button, "pointerdown");
    },
    true,
  );
  window.addEventListener("keyup", (event) => release(event.key.toLowerCase()), true);
  window.addEventListener("blur", () => [...held.keys()].forEach(release));
})();
