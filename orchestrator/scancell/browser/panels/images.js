// A click on the camera images presses the button that enlarges the image that was clicked.
(() => {
  if (window.scancellImages) return;
  window.scancellImages = true;
  window.addEventListener("click", (event) => {
    const picture = event.target.closest("img");
    if (!picture?.parentElement.parentElement.textContent.endsWith("@CLICK@")) return;
    let row = [...document.querySelectorAll("label")].find((one) => one.textContent === "@ENLARGE@");
    while (row && !row.querySelector("button")) row = row.parentElement;
    const buttons = row ? row.querySelectorAll("button") : [];
    const box = picture.getBoundingClientRect();
    buttons[Math.floor((buttons.length * (event.clientX - box.left)) / box.width)]?.click();
  });
})();
