// A click on a configuration map writes its place into the inputs beside it, as if it were typed.
((event) => {
  const box = event.currentTarget.getBoundingClientRect();
  const write = (label, value) => {
    const found = [...document.querySelectorAll("label")].find((one) => one.textContent.trim() === label);
    let row = found;
    while (row && !row.querySelector("input:not([type=hidden])")) row = row.parentElement;
    const input = row?.querySelector("input:not([type=hidden])");
    if (!input || input.disabled) return;
    Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set.call(input, value.toFixed(1));
    input.dispatchEvent(new Event("input", { bubbles: true }));
  };
  const share = (at, from, size) => Math.min(Math.max((at - from) / size, 0), 1);
  write("@ALONG@", 100 * share(event.clientX, box.left, box.width));
  write("@ANGLE@", 360 * (1 - share(event.clientY, box.top, box.height)));
})(event);
