// The two parts of the expression lab that ipywidgets lacks: the error over alpha with its slider,
// and a bar for each unit. The kernel sends numbers; what is drawn from them is settled here.

const SVG = "http://www.w3.org/2000/svg";

function svg(name, attributes, parent, text = "") {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.textContent = text;
  parent.append(made);
  return made;
}

function html(name, className, parent, text = "") {
  const made = document.createElement(name);
  made.className = className;
  made.textContent = text;
  parent.append(made);
  return made;
}

function follow(model, names, react) {
  for (const name of names) model.on("change:" + name, react);
  return () => names.forEach((name) => model.off("change:" + name, react));
}

// RMS distance over alpha. Alpha is drawn on a square root scale, for natural faces have small
// sums; the slider below has the same scale, its steps are the places of the alphas.
function curve({ model, el }) {
  const [width, height, left, right, top, bottom] = [320, 118, 52, 10, 8, 30];
  el.classList.add("facelab-curve");
  const alphas = model.get("alphas");
  const last = Math.sqrt(alphas[alphas.length - 1]);
  const x = (alpha) => left + (Math.sqrt(alpha) / last) * (width - left - right);
  const canvas = svg("svg", { width, height, viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": "RMS distance over the sum of the weights, alpha" }, el);
  const clip = svg("clipPath", { id: "facelab-clip-" + Math.random().toString(36).slice(2) }, canvas);
  svg("rect", { x: left - 6, y: 0, width: width - left - right + 12, height: height - bottom }, clip);
  const paper = svg("g", {}, canvas);
  const row = html("div", "facelab-alpha", el);
  const slider = html("input", "", row);
  slider.type = "range";
  slider.setAttribute("aria-label", "alpha");
  // steps of equal width on the square root scale; the nearest alpha counts
  Object.assign(slider, { min: 0, max: last, step: last / 400 });
  const nearest = (root) => {
    let best = 0;
    alphas.forEach((a, i) => {
      if (Math.abs(Math.sqrt(a) - root) < Math.abs(Math.sqrt(alphas[best]) - root)) best = i;
    });
    return best;
  };
  slider.addEventListener("input", () => choose(nearest(Number(slider.value))));
  slider.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1 }[event.key];
    if (!step) return;
    event.preventDefault();
    choose(Math.min(Math.max(model.get("place") + step, 0), alphas.length - 1));
  });
  let chosen = null; // the last that the kernel was told: what it showed before hearing of it is old
  const choose = (place) => {
    if (place === model.get("place")) return;
    chosen = place;
    model.set("place", place);
    model.save_changes();
    mark();
  };
  canvas.addEventListener("pointerdown", (event) => {
    const at = (event.offsetX - left) / (width - left - right);
    if (event.offsetY < height - bottom) choose(nearest(Math.min(Math.max(at, 0), 1) * last));
  });
  let y = () => 0;
  let moving = null;

  const mark = () => {
    const place = model.get("place");
    slider.value = Math.sqrt(alphas[place]);
    moving?.remove();
    moving = svg("g", {}, paper);
    const at = [x(alphas[place]), Math.max(y(model.get("rms")[place]), top)];
    svg("line", { x1: at[0], x2: at[0], y1: top, y2: height - bottom, stroke: "#0072b2" }, moving);
    svg("circle", { cx: at[0], cy: at[1], r: 4.5, fill: "#0072b2", stroke: "#fff" }, moving);
  };
  const draw = () => {
    const rms = model.get("rms");
    const seen = rms.filter((_, i) => alphas[i] <= 10);
    const most = Math.max(1.15 * Math.max(...seen), 0.01);
    y = (value) => height - bottom - (value / most) * (height - bottom - top);
    paper.replaceChildren();
    const text = { "font-size": 11, fill: "var(--jp-ui-font-color1, #444)" };
    const beyond = x(Math.min(model.get("reach"), alphas[alphas.length - 1]));
    svg("rect", { x: beyond, y: top, width: Math.max(width - right - beyond, 0),
      height: height - bottom - top, fill: "var(--jp-layout-color2, #ececec)" }, paper);
    for (const a of [0, 1, 2, 5, 10, 20, 50, 100]) {
      svg("line", { x1: x(a), x2: x(a), y1: height - bottom, y2: height - bottom + 4, stroke: "var(--jp-ui-font-color2, #888)" }, paper);
      svg("text", { x: x(a), y: height - bottom + 15, "text-anchor": "middle", ...text }, paper, a);
    }
    svg("text", { x: (left + width) / 2, y: height - 2, "text-anchor": "middle", ...text }, paper, "α");
    for (const v of [0, most / 2, most]) {
      svg("text", { x: left - 5, y: y(v) + 4, "text-anchor": "end", ...text }, paper, v.toFixed(most < 1 ? 2 : 1));
    }
    const middle = (top + height - bottom) / 2;
    svg("text", { x: 12, y: middle, transform: `rotate(-90 12 ${middle})`, "text-anchor": "middle", ...text },
      paper, "RMS (mm)");
    svg("path", { d: `M${left} ${top}V${height - bottom}H${width - right}`, fill: "none", stroke: "var(--jp-ui-font-color2, #888)" }, paper);
    const points = rms.map((v, i) => `${x(alphas[i]).toFixed(1)},${y(v).toFixed(1)}`).join(" ");
    svg("polyline", { points, fill: "none", stroke: "var(--jp-ui-font-color1, #333)", "stroke-width": 1.6, "clip-path": `url(#${clip.id})` }, paper);
    const best = model.get("best");
    const at = [x(alphas[best]), Math.max(y(rms[best]), top)];
    const star = svg("path", { d: `M${at[0]} ${at[1] - 7}l6 7-6 7-6-7z`, fill: "#e69f00", stroke: "#333" }, paper);
    svg("title", {}, star, `best: α = ${alphas[best]}`);
    mark();
  };
  const hear = ({ heard, place }) => heard === chosen && model.set("place", place);
  draw();
  model.on("msg:custom", hear);
  const undraw = follow(model, ["rms", "best", "reach"], draw);
  const unmark = follow(model, ["place"], mark);
  return () => { undraw(); unmark(); model.off("msg:custom", hear); };
}

// A row for each unit: picture, name, bar (to be dragged), lock, exclude.
function bars({ model, el }) {
  el.classList.add("facelab-units");
  // Edits arrive in order, and none is lost: while the kernel is busy with some the next ones wait;
  // of a drag only its last place does.
  let waiting = [];
  let asked = null;
  const told = new Map(); // weights by unit, until the kernel has heard of all
  const send = () => {
    asked = waiting.length ? Math.random() : null;
    if (asked) model.send({ edits: waiting, asked });
    waiting = [];
  };
  const tell = (what, unit, value) => {
    const last = waiting[waiting.length - 1];
    if (what === "weight" && last?.[0] === "weight" && last[1] === unit) waiting.pop();
    waiting.push([what, unit, value]);
    if (what === "weight") told.set(unit, value);
    if (!asked) send();
  };
  const hear = ({ heard }) => {
    if (heard !== asked) return;
    send();
    if (!asked) told.clear();
  };
  const tellNow = () => waiting.length && send();
  model.on("msg:custom", hear);
  document.addEventListener(TELL, tellNow);
  const rows = model.get("units").map((unit, index) => {
    const row = html("div", "facelab-unit", el);
    row.title = unit.tip;
    if (unit.picture) {
      const picture = html("img", "", row);
      picture.src = "data:image/png;base64," + unit.picture;
      picture.alt = "";
    }
    html("span", "facelab-unit-name", row, unit.name);
    const bar = html("div", "facelab-unit-bar", row);
    const zero = html("div", "facelab-unit-zero", bar);
    const filled = html("div", "facelab-unit-filled", bar);
    const number = html("span", "facelab-unit-number", row);
    const button = (what, sign, tip) => {
      const made = html("button", "", row, sign);
      made.title = tip;
      made.setAttribute("aria-label", `${what} ${unit.name}`);
      made.addEventListener("click", () => tell(what, index, 0));
      return made;
    };
    const lock = button("lock", "⚓", "Lock at this weight; again to let go");
    const out = button("exclude", "✕", "Leave this unit out; again to let it in");
    const at = (event) => {
      const box = bar.getBoundingClientRect();
      const [low, high] = scale();
      const share = Math.min(Math.max((event.clientX - box.left) / box.width, 0), 1);
      return Math.round(100 * (low + share * (high - low))) / 100;
    };
    bar.title = "Drag to set this weight by hand: that locks it";
    Object.assign(bar, { tabIndex: 0, role: "slider" });
    bar.setAttribute("aria-label", unit.name);
    bar.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: -0.05, ArrowDown: -0.05, ArrowRight: 0.05, ArrowUp: 0.05 }[event.key];
      if (!step) return;
      event.preventDefault();
      const weight = told.get(index) ?? model.get("weights")[index];
      tell("weight", index, Math.round(100 * (weight + step)) / 100);
      tell("settle", index, 0);
    });
    bar.addEventListener("pointerdown", (event) => {
      held = scale();
      bar.setPointerCapture(event.pointerId);
      tell("weight", index, at(event));
    });
    bar.addEventListener("pointermove", (event) => {
      if (held && bar.hasPointerCapture(event.pointerId)) tell("weight", index, at(event));
    });
    bar.addEventListener("lostpointercapture", () => { held = null; tell("settle", index, 0); });
    return { row, bar, filled, zero, number, lock, out };
  });
  let held = null; // the scale while a bar is dragged
  const scale = () => {
    const weights = model.get("weights");
    return held ?? [Math.min(0, ...weights), Math.max(1, ...weights)];
  };
  const draw = () => {
    const [low, high] = scale();
    const place = (w) => (100 * (Math.min(Math.max(w, low), high) - low)) / (high - low);
    const states = model.get("states");
    model.get("weights").forEach((w, i) => {
      const { row, bar, filled, zero, number, lock, out } = rows[i];
      bar.setAttribute("aria-valuenow", w.toFixed(2));
      bar.setAttribute("aria-valuemin", low);
      bar.setAttribute("aria-valuemax", high);
      filled.style.left = place(Math.min(w, 0)) + "%";
      filled.style.width = place(Math.max(w, 0)) - place(Math.min(w, 0)) + "%";
      zero.style.left = place(0) + "%";
      number.textContent = Math.abs(w) < 0.005 ? "" : w.toFixed(2);
      row.dataset.state = states[i];
      lock.setAttribute("aria-pressed", states[i] === "locked");
      out.setAttribute("aria-pressed", states[i] === "excluded");
      lock.disabled = out.disabled = states[i] === "dropped";
    });
  };
  const sort = () => {
    model.get("order").forEach((unit, place) => (rows[unit].row.style.order = place));
  };
  draw();
  sort();
  const undraw = follow(model, ["weights", "states"], draw);
  const unsort = follow(model, ["order"], sort);
  return () => {
    undraw();
    unsort();
    model.off("msg:custom", hear);
    document.removeEventListener(TELL, tellNow);
  };
}

export default {
  initialize: stayInTouch,
  render: (context) => (context.model.get("kind") === "curve" ? curve : bars)(context),
};
