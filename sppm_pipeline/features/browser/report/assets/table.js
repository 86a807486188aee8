// The table of a sweep: all rows from their packed JSON, sorted by the heading that was clicked, shown in portions.
{
  const head = jsonOf("head-rows"), table = byId("rows"), body = table.tBodies[0], more = byId("rows-more");
  const PORTION = 200;
  // as the rows that stand in the page are written: six digits, powers of ten for what is small or large
  const text = (value) => {
    if (value === null) return "";
    if (typeof value === "boolean") return value ? "True" : "False";
    if (typeof value !== "number" || Number.isInteger(value)) return String(value);
    const short = +value.toPrecision(6), size = Math.abs(short);
    return size >= 1e-4 && size < 1e6 ? String(short) : short.toExponential().replace(/e([+-])(\d)$/, "e$10$2");
  };
  let rows = [], count = 0, by = -1, down = false;

  function fill(upTo) {
    for (; count < Math.min(upTo, rows.length); count++) {
      const line = body.insertRow();
      for (const value of rows[count]) line.insertCell().textContent = text(value);
    }
    byId("rows-readout").textContent = `${count} of ${rows.length} rows`;
    more.hidden = count >= rows.length;
  }

  function compare(a, b) {
    if (a === null || b === null) return (a === null) - (b === null);
    if (typeof a === "number" && typeof b === "number") return down ? b - a : a - b;
    return down ? String(b).localeCompare(String(a)) : String(a).localeCompare(String(b));
  }

  function sort(column, heading) {
    down = by === column && !down;
    by = column;
    for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
    heading.setAttribute("aria-sort", down ? "descending" : "ascending");
    rows.sort((a, b) => compare(a[column], b[column]));
    body.replaceChildren();
    count = 0;
    fill(PORTION);
  }

  unpacked(bytesOf("data-rows")).then((bytes) => {
    rows = JSON.parse(new TextDecoder().decode(bytes));
    count = Math.min(body.rows.length, rows.length);
    [...table.tHead.rows[0].cells].forEach((heading, column) => {
      heading.dataset.sort = "";
      heading.tabIndex = 0;
      heading.addEventListener("click", () => sort(column, heading));
      heading.addEventListener("keydown", (event) => { if (event.key === "Enter") sort(column, heading); });
    });
    more.addEventListener("click", () => fill(count + PORTION));
    byId("rows-controls").hidden = false;
    fill(count);
  });
}
