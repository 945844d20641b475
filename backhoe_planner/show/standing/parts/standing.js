"use strict";
{
  const told = document.getElementById("told");
  const cells = document.querySelectorAll("#map .cell");
  let chosen = null;
  const tell = (cell) => { told.textContent = cell.dataset.told; };
  for (const cell of cells) {
    cell.addEventListener("pointerenter", () => tell(cell));
    cell.addEventListener("click", () => {
      if (chosen) chosen.classList.remove("chosen");
      chosen = cell;
      cell.classList.add("chosen");
      tell(cell);
    });
  }
}
