// Cells of a map that have more to tell: a tap or the focus shows it below the map, arrow keys go from cell to cell.
(function () {
  const MORE = "table.heat td[title]", WAYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
  const words = (cell) => {
    const table = cell.closest("table"), [over, under] = table.tHead.rows, n = cell.cellIndex - 1;
    const top = over.cells[1 + Math.floor(n / over.cells[1].colSpan)];
    return [top.textContent, ...(under ? [under.cells[n].textContent] : []), cell.parentNode.cells[0].textContent].join(", ");
  };
  function tell(cell) {
    for (const other of cell.closest("table").querySelectorAll("td[tabindex]")) if (other !== cell) other.removeAttribute("tabindex"); // the tab key comes back to this one
    cell.closest(".map").querySelector(".cell-told").textContent = `${words(cell)}: ${cell.title}`;
  }
  const go = (cell) => { if (cell) { cell.tabIndex = 0; cell.focus(); } };
  document.addEventListener("click", ({ target }) => go(target.closest?.(MORE)));
  document.addEventListener("focusin", ({ target }) => { if (target.matches(MORE)) tell(target); });
  document.addEventListener("keydown", (e) => {
    const [across, down] = WAYS[e.key] ?? [0, 0];
    if (!e.target.matches?.(MORE) || !(across || down)) return;
    e.preventDefault();
    const { cellIndex: x, parentNode: row } = e.target;
    const ahead = (c) => (across ? c.parentNode === row && (c.cellIndex - x) * across > 0 : c.cellIndex === x && (c.parentNode.rowIndex - row.rowIndex) * down > 0);
    const found = [...e.target.closest("table").querySelectorAll("td[title]")].filter(ahead);
    go(across + down > 0 ? found[0] : found.at(-1));
  });
})();
