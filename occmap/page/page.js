// What the page does: unpack the layers of its maps, paint what is in view, say what is under the
// pointer, lay a scan over the map, and sort tables. It asks the network for nothing.
"use strict";
(() => {
  const DATA = JSON.parse(document.getElementById("data").textContent);
  const find = id => document.getElementById(id);
  const number = (value, digits) =>
    value.toLocaleString("en-US", {minimumFractionDigits: digits, maximumFractionDigits: digits});

  const toText = (layer, value) => number(layer.start + value * layer.scale, layer.digits);

  function makeElement(kind, text, name) {
    const element = document.createElement(kind);
    element.textContent = text;
    if (name) element.className = name;
    return element;
  }

  // Arrays: deflated, the lowest bytes of all numbers first; see raster.py.
  const asked_for = new Map(), unpacked = new Map();
  function unpack(packed) {
    if (!asked_for.has(packed))
      asked_for.set(packed, inflate(packed).then(array => (unpacked.set(packed, array), array)));
    return asked_for.get(packed);
  }
  async function inflate({rows, columns, planes, data}) {
    const text = atob(data);
    const bytes = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    const plain = new Uint8Array(await new Response(stream).arrayBuffer());
    const size = rows * columns;
    if (planes === 1) return plain;
    const numbers = planes === 2 ? new Uint16Array(size) : new Uint32Array(size);
    for (let plane = 0; plane < planes; plane++)
      for (let i = 0, at = plane * size; i < size; i++) numbers[i] |= plain[at + i] << (8 * plane);
    return numbers;
  }

  // Colours: a table for each layer, from numbers to red, green, blue and alpha in one word.
  const CLEAR = 0;
  function toWord(colour) {
    const rgb = parseInt(colour.slice(1), 16);
    return (0xff000000 | (rgb & 255) << 16 | rgb & 0xff00 | rgb >> 16) >>> 0;
  }
  const TOP = 65535;
  function makeTable(layer, largest) {
    const words = layer.colours.map(toWord);
    const table = new Uint32Array(Math.min(largest, TOP) + 1);
    const shade = layer.kind === "log"
      ? value => Math.log1p(value) / Math.log1p(layer.top)
      : value => value / layer.top;
    for (let value = 0; value < table.length; value++)
      table[value] = layer.kind === "classes" ? words[value]
        : words[Math.min(Math.round(shade(value) * (words.length - 1)), words.length - 1)];
    if (layer.none < table.length) table[layer.none] = CLEAR;
    return table;
  }

  // Painting: only what is in view and only as fine as the screen is. Where several cells share a
  // pixel it shows the largest number, so that no thin wall is lost.
  const {ndarray} = window.Bokeh ? Bokeh.require("core/util/ndarray") : {};
  function paint(map, cells, layer) {
    const {raster, figure} = map, spec = raster.layers[layer.key];
    const {x_range, y_range} = figure;
    const clip = (value, most) => Math.min(Math.max(value, 0), most);
    const wide = (x_range.end - x_range.start) / raster.size, high = (y_range.end - y_range.start) / raster.size;
    const step = Math.max(1, Math.floor(wide / Math.max(figure.inner_width, 200)));
    const left = (x_range.start - raster.x) / raster.size, low = (y_range.start - raster.y) / raster.size;
    const snap = value => Math.floor(value / step) * step;
    const c0 = snap(clip(left - wide / 4, spec.columns)), c1 = clip(Math.ceil(left + 1.25 * wide), spec.columns);
    const r0 = snap(clip(low - high / 4, spec.rows)), r1 = clip(Math.ceil(low + 1.25 * high), spec.rows);
    const columns = Math.ceil((c1 - c0) / step), rows = Math.ceil((r1 - r0) / step);
    if (columns <= 0 || rows <= 0) return;
    const image = new Uint32Array(columns * rows), table = layer.table, none = layer.none;
    for (let r = r0, out = 0; r < r1; r += step) {
      const r2 = Math.min(r + step, r1);
      for (let c = c0; c < c1; c += step, out++) {
        let most = -1;
        const c2 = Math.min(c + step, c1);
        for (let i = r; i < r2; i++)
          for (let j = c, at = i * spec.columns + c; j < c2; j++, at++)
            if (cells[at] > most && cells[at] !== none) most = cells[at];
        image[out] = most < 0 ? CLEAR : table[Math.min(most, TOP)];
      }
    }
    map.source.data = {
      image: [ndarray(image, {dtype: "uint32", shape: [rows, columns]})],
      x: [raster.x + c0 * raster.size], y: [raster.y + r0 * raster.size],
      dw: [columns * step * raster.size], dh: [rows * step * raster.size],
    };
  }

  // Looking: all maps show one layer and one part of the world.
  const maps = (DATA.maps || []).map((raster, index) => ({raster, index}));
  let current = null, asked = false;
  function repaint() {
    if (asked) return;
    asked = true;
    requestAnimationFrame(async () => {
      asked = false;
      const layer = current;
      for (const map of maps) {
        const cells = await unpack(map.raster.layers[layer.key]);
        if (layer === current) paint(map, cells, {...layer, table: tableOf(layer)});
      }
      document.body.dataset.layer = layer.key;
      if (!settled) {
        settled = true;
        requestAnimationFrame(() => requestAnimationFrame(settle));
      }
    });
  }
  let settled = false;
  function settle() {
    document.body.dataset.drawn = Math.round(performance.now());
    prepare();
  }
  // What the pointer will ask for is unpacked once the map is there, a layer after the other.
  async function prepare() {
    for (const {raster} of maps)
      for (const spec of Object.values(raster.layers)) {
        await unpack(spec);
        await new Promise(resolve => setTimeout(resolve));
      }
  }
  const tables = new Map();
  function tableOf(layer) {
    if (!tables.has(layer.key)) {
      const largest = Math.max(...maps.map(map => map.raster.layers[layer.key].largest), layer.colours.length - 1);
      tables.set(layer.key, makeTable(layer, largest));
    }
    return tables.get(layer.key);
  }

  function show(layer) {
    current = layer;
    for (const button of find("layers").children)
      button.setAttribute("aria-pressed", button.dataset.key === layer.key);
    find("layer").textContent = layer.label;
    const legend = find("legend");
    legend.replaceChildren();
    if (layer.kind === "classes")
      layer.names.forEach((name, value) => name && legend.append(makeSwatch(layer.colours[value], name)));
    else if (layer.kind === "time") legend.append(...makeRamp(layer.colours, "early", "late"));
    else legend.append(...makeRamp(layer.colours, toText(layer, 0), toText(layer, layer.top)));
    repaint();
  }
  function makeSwatch(colour, name) {
    const row = makeElement("div", "", "swatch"), box = document.createElement("i");
    box.style.background = colour;
    row.append(box, makeElement("span", name));
    return row;
  }
  function makeRamp(colours, low, high) {
    const ramp = makeElement("div", "", "ramp"), ends = makeElement("div", "", "ends");
    ramp.style.background = `linear-gradient(to right, ${colours.join(",")})`;
    ends.append(makeElement("span", low), makeElement("span", high));
    return [ramp, ends];
  }

  // The pointer: everything that is known of the cell under it.
  let pointed = 0;
  function point(map, {x, y}) {
    const turn = ++pointed, {raster} = map, rows = [["x, y", `${number(x, 3)}, ${number(y, 3)} m`]];
    const column = Math.floor((x - raster.x) / raster.size), row = Math.floor((y - raster.y) / raster.size);
    const missing = [];
    let known = true;
    for (const layer of DATA.layers) {
      const spec = raster.layers[layer.key], cells = unpacked.get(spec);
      const inside = row >= 0 && row < spec.rows && column >= 0 && column < spec.columns;
      if (!cells) missing.push(unpack(spec));
      const value = inside && cells ? cells[row * spec.columns + column] : 0;
      if (layer.key === "class") known = value > 0;
      rows.push([layer.label, !cells ? "\u2026" : known || layer.kind === "classes" ? describe(layer, value) : "\u2013"]);
    }
    find("pointer").replaceChildren(...rows.flatMap(([name, text]) => [makeElement("dt", name), makeElement("dd", text)]));
    if (missing.length) Promise.race(missing).then(() => turn === pointed && point(map, {x, y}));
  }
  function describe(layer, value) {
    if (layer.kind === "classes") return layer.names[value];
    if (value === layer.none && layer.kind !== "log") return "\u2013";
    if (layer.kind === "time") return writeSlice(layer.start + value * layer.scale, layer.scale);
    return toText(layer, value);
  }
  // Stamps as in the log, so that `occmap explain` has them, too; and dates, where they are some.
  const writeTime = seconds => `${seconds.toFixed(3)} s${date(seconds)}`;
  const writeSlice = (end, length) => `${(end - length).toFixed(3)} to ${end.toFixed(3)} s${date(end - length)}`;
  function date(seconds) {
    if (seconds < 631152000 || seconds >= 4102444800) return "";
    return ` (${new Date(seconds * 1e3).toISOString().slice(0, 19).replace("T", " ")} UTC)`;
  }

  // The whole map in the middle, a metre as long in x as in y.
  function fit(map) {
    const {figure} = map, {box} = DATA;
    const wide = box[2] - box[0], high = box[3] - box[1];
    const scale = Math.max(wide / figure.inner_width, high / figure.inner_height) * 1.03;
    const set = (range, middle, half) => {
      const ends = {start: middle - half, end: middle + half};
      range.setv({...ends, reset_start: ends.start, reset_end: ends.end});
    };
    set(figure.x_range, (box[0] + box[2]) / 2, scale * figure.inner_width / 2);
    set(figure.y_range, (box[1] + box[3]) / 2, scale * figure.inner_height / 2);
  }

  // Where a window, or a scrollbar, changes the size: the same width in metres, and the shape.
  function keepShape({x_range, y_range, inner_width, inner_height}) {
    const middle = (y_range.start + y_range.end) / 2;
    const half = (x_range.end - x_range.start) / inner_width * inner_height / 2;
    y_range.setv({start: middle - half, end: middle + half});
  }

  // The slider: one scan over the map.
  async function layScan(index) {
    const {scans, origin, unit} = DATA.journey, document_ = maps[0].figure.document;
    const source = document_.get_model_by_name("scan").data_source, robot = document_.get_model_by_name("robot").data_source;
    const from = index < 0 ? 0 : scans.ends[index - 1] || 0, to = index < 0 ? 0 : scans.ends[index];
    const [xs, ys] = await Promise.all(scans.hits.map(unpack));
    const take = (cells, start) => Float64Array.from(cells.subarray(from, to), value => start + value * unit);
    source.data = {x: take(xs, origin[0]), y: take(ys, origin[1])};
    robot.data = index < 0 ? {x: [], y: []} : {x: [scans.x[index]], y: [scans.y[index]]};
    find("when").textContent = index < 0 ? "move to lay one scan over the map" : writeTime(scans.t[index]);
    document.body.dataset.scan = index;
  }

  // Drawing: a click adds a corner, a double-click ends the shape. Saved are lines for `--edits`.
  const shapes = [];
  let open = false;
  function addCorner({x, y}) {
    if (find("draw").getAttribute("aria-pressed") !== "true") return;
    if (!open) shapes.push({change: find("change").value, corners: []});
    open = true;
    shapes.at(-1).corners.push([x, y]);
    showShapes();
  }
  function dropCorner() {
    const {corners} = shapes.at(-1);
    corners.pop();
    open = corners.length > 0;
    if (!open) shapes.pop();
    showShapes();
  }
  function showShapes() {
    const source = name => maps[0].figure.document.get_model_by_name(name).data_source;
    const pick = axis => shapes.map(({corners}) => corners.map(corner => corner[axis]));
    source("drawn").data = {xs: pick(0), ys: pick(1)};
    source("corners").data = {x: pick(0).flat(), y: pick(1).flat()};
    find("undo").disabled = find("save").disabled = !shapes.length;
  }
  function saveShapes() {
    const lines = shapes.filter(({corners}) => corners.length > 1).map(({change, corners}) =>
      [change, corners.length > 2 ? "polygon" : "line", ...corners.flat().map(each => each.toFixed(3))].join(","));
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([lines.join("\n") + "\n"], {type: "text/csv"}));
    link.download = "edits.csv";
    link.click();
  }
  function prepareDrawing(figure) {
    figure.on_event("tap", addCorner);
    figure.on_event("doubletap", () => { open = false; });
    find("draw").onclick = ({target}) => {
      open = false;
      target.setAttribute("aria-pressed", target.getAttribute("aria-pressed") !== "true");
    };
    find("undo").onclick = dropCorner;
    find("save").onclick = saveShapes;
  }

  function start() {
    const document_ = Bokeh.documents[0];
    for (const map of maps) {
      map.figure = document_.get_model_by_name(`map-${map.index}`);
      map.source = document_.get_model_by_name(`image-${map.index}`).data_source;
      for (const kind of ["mousemove", "tap"]) map.figure.on_event(kind, event => point(map, event));
    }
    if (maps.some(map => !(map.figure.inner_width > 0))) return setTimeout(start, 20);
    fit(maps[0]);
    for (const range of [maps[0].figure.x_range, maps[0].figure.y_range]) range.change.connect(repaint);
    const {inner_width, inner_height} = maps[0].figure.properties;
    for (const side of [inner_width, inner_height]) side.change.connect(() => keepShape(maps[0].figure));
    find("whole").onclick = () => fit(maps[0]);
    for (const layer of DATA.layers) {
      const button = makeElement("button", layer.label);
      button.dataset.key = layer.key;
      button.onclick = () => show(layer);
      find("layers").append(button);
    }
    if (find("way")) {
      const [colours, start, end] = DATA.journey.ramp;
      find("way-ramp").append(...makeRamp(colours, writeTime(start), writeTime(end)));
      find("way").onchange = event => {
        for (const name of ["way", "dropped"]) document_.get_model_by_name(name).visible = event.target.checked;
      };
    }
    if (find("draw")) prepareDrawing(maps[0].figure);
    if (find("scan")) find("scan").oninput = event => layScan(Number(event.target.value));
    show(DATA.layers[0]);
  }

  // Tables: a click on a heading sorts by its column, a second click the other way round.
  function sort(heading) {
    const table = heading.closest("table"), column = [...heading.parentNode.children].indexOf(heading);
    const way = heading.getAttribute("aria-sort") === "ascending" ? -1 : 1;
    for (const other of heading.parentNode.children) other.removeAttribute("aria-sort");
    heading.setAttribute("aria-sort", way > 0 ? "ascending" : "descending");
    const value = row => row.children[column].textContent;
    const measure = row => parseFloat(value(row).replaceAll(",", ""));
    const order = heading.className === "number"
      ? (a, b) => way * ((measure(a) || 0) - (measure(b) || 0))
      : (a, b) => way * value(a).localeCompare(value(b));
    table.tBodies[0].append(...[...table.tBodies[0].rows].sort(order));
  }
  for (const heading of document.querySelectorAll("th")) heading.onclick = () => sort(heading);

  if (maps.length) {
    const wait = () => window.Bokeh && Bokeh.documents.length ? start() : setTimeout(wait, 10);
    wait();
  }
})();
