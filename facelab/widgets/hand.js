// The hand on a face: hover, press, pull and camera, all in the page. The kernel hears where the
// face was taken hold of, now and then where the mouse is, and exactly where it was let go.

const EVERY = 125; // ms: with a press and a release, at most ten messages a second
const NEAR = 12; // pixels: a pin this near to the mouse is what it takes
const BENEATH = 5; // mm that a pin may lie under the skin and is still seen
const MANY = 24; // pins: a ray for each takes half a millisecond
const RIM = 3; // mm: a mouse this near to a lid or lip, but in the opening, is on its rim
const AVERTED = 0.2; // of a normal: skin in a crease, as the corner of a mouth, looks away so far
const STILL = 0.6; // mm: a hand that only clicks moves less
const REST = 400; // ms: a pointer that has rested on the face turns its wheel there
const STEP = 0.5; // mm an arrow key moves a pin
const PAUSE = 400; // ms without an arrow key end such a pull
const WIDEST = 1.6; // of the width that was asked for
const GAP = 12; // pixels between faces
const HIGHEST = 0.8; // of the window
const BOTH_SIDES = 2; // three.DoubleSide
const SVG = "http://www.w3.org/2000/svg";
const PULL = "facelab-pull"; // tells the other views of a face what is pulled, and where to
const VIEWS = [
  ["F", "From the front", [0, 0, 1]],
  ["L", "From the person's left", [1, 0, 0]],
  ["R", "From the person's right", [-1, 0, 0]],
  ["T", "From above", [0, 1, 0.01]],
  ["¾", "Three-quarter view", [0.7, 0.1, 0.7]],
];

const typed = (Kind, view) =>
  new Kind(view.buffer.slice(view.byteOffset, view.byteOffset + view.byteLength));
const sparse = (told) => told && {
  starts: typed(Int32Array, told.starts),
  columns: typed(Int32Array, told.columns),
  values: typed(Float64Array, told.values),
};
const add = (a, b, by = 1) => a.map((x, i) => x + by * b[i]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const clamp = (x, low, high) => Math.min(Math.max(x, low), high);
const unit = (a) => a.map((x) => x / Math.hypot(...a));
const row = (X, v) => [X[3 * v], X[3 * v + 1], X[3 * v + 2]];

function element(name, attributes, parent) {
  const made = name === "button" || name === "div"
    ? document.createElement(name) : document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  parent?.append(made);
  return made;
}

// The skin as it is drawn: what the kernel last sent, and on top of it what is being pulled.
class Skin {
  constructor(model, face, position, normal) {
    Object.assign(this, { model, position, normal });
    this.faces = face.obj.geometry.index.array;
    this.n = model.get("n_vertices");
    this.nFaces = model.get("n_faces");
    this.rim = model.get("rim");
    this.riders = sparse(model.get("riders"));
    this.offsets = typed(Float64Array, model.get("riders").offsets);
  }

  get told() {
    return this.position.get("array").data;
  }

  get X() {
    return this.position.obj.array;
  }

  get N() {
    return this.normal.obj.array;
  }

  // Draw base + what `moved(pull)` adds; the lining rides along.
  draw(base, moved, pull) {
    const X = new Float64Array(this.told.length);
    for (let i = 0; i < 3 * this.n; i++) X[i] = base[i];
    moved(pull, X);
    X.set(this.offsets, 3 * this.n);
    addProduct(this.riders, X, X, this.n);
    const N = Float32Array.from(this.normal.get("array").data);
    normalsOf(X, this.faces, this.nFaces, this.n, N);
    this.#set(Float32Array.from(X), N);
  }

  // Back to what the kernel sent.
  rest() {
    this.#set(this.told, this.normal.get("array").data);
  }

  #set(X, N) {
    this.position.obj.setArray(X);
    this.normal.obj.setArray(N);
    this.position.obj.needsUpdate = this.normal.obj.needsUpdate = true;
  }
}

// Tells the kernel what happens, now and then; `now` at once, and nothing that waits survives it.
function teller(model) {
  let last = -Infinity, waiting = null, timer = 0;
  const send = () => {
    timer = 0;
    if (!waiting) return;
    last = performance.now();
    try {
      model.send(waiting);
    } catch (error) {
      console.warn(error); // the kernel has gone; the page says so
    }
    waiting = null;
  };
  return {
    soon(message) {
      waiting = message;
      timer ||= setTimeout(send, Math.max(0, last + EVERY - performance.now()));
    },
    now(message = waiting) {
      clearTimeout(timer);
      waiting = message;
      send();
    },
  };
}

// pythreejs tells the kernel of each buffer that the kernel has just sent: a dozen messages for a
// pose, which wait in line before those of the hand. Nobody reads them.
function hush(scene) {
  scene.traverse(({ geometry }) => {
    for (const { ipymodel } of Object.values(geometry?.attributes ?? {}))
      if (ipymodel) ipymodel.save_changes = () => {};
  });
}

// Skin is seen from both sides. three.js turns the normals of a triangle that looks away even where
// the smooth normal does not: at a crease and along an outline that makes dark specks.
const FACING = `vec3 normal = normalize(vNormal);
if (dot(normal, normalize(vViewPosition)) < -0.3) normal = -normal;`;

// Whether any skin had to be told so: that of a texture comes when it is first wanted.
function smoothen(scene) {
  let any = false;
  scene.traverse(({ material }) => {
    if (!material?.isMeshStandardMaterial || material.side !== BOTH_SIDES || material.userData.smooth) return;
    any = material.needsUpdate = material.userData.smooth = true;
    material.onBeforeCompile = (shader) => {
      const plain = shader.fragmentShader;
      shader.fragmentShader = plain.replace("#include <normal_fragment_begin>", FACING);
      if (shader.fragmentShader === plain) console.error("three.js has another shader: skin may show specks");
    };
  });
  return any;
}

// The kernel hears by several threads, so messages may come in another order than they went: each
// says which vertex is held, and how pulls before it have ended that were not dealt with by then.
const about = ({ press, vertex, before }) => ({ press, vertex, before });
const end = ({ press, vertex, moved, offset }) =>
  ({ do: "release", press, vertex, offset: moved ? offset : null });

class Hand {
  constructor(model, el, parts) {
    Object.assign(this, parts, { model, el });
    this.middle = model.get("middle");
    this.tell = teller(model);
    this.drag = null; // {press, vertex, offset, moved, answer}
    this.let = new Map(); // pulls let go of, which the kernel has not dealt with yet
    this.under = null; // what is under the mouse
    this.lastPin = null;
    this.chosen = null; // the pin that Tab has come to
    this.rested = performance.now();
    this.listening = new AbortController();
    hush(this.view.scene);
    this.stage.facelab = this; // for who wants to look in from outside
    this.#build();
    this.#listen();
    this.fit();
    this.redraw();
  }

  #build() {
    this.marks = element("svg", { class: "facelab-marks", "aria-hidden": "true" }, this.el);
    this.label = element("div", { class: "facelab-label", role: "status" }, this.el);
    this.notes = element("div", { class: "facelab-notes", "aria-hidden": "true" }, this.el);
    const bar = this.bar = element("div", { class: "facelab-views", role: "toolbar", "aria-label": "View" }, this.el);
    const button = (sign, tip, react) => {
      const made = element("button", { title: tip, "aria-label": tip, type: "button" }, bar);
      made.textContent = sign;
      made.addEventListener("click", react);
    };
    for (const [sign, tip, way] of VIEWS) button(sign, tip, () => this.lookFrom(way));
    button("★", "My view (with Shift: keep the present one as it)", (event) => {
      const away = this.eye();
      if (event.shiftKey || !this.own) this.own = away;
      this.lookFrom(this.own, Math.hypot(...this.own));
    });
    button("⤢", "Full screen", () =>
      document.fullscreenElement ? document.exitFullscreen() : this.stage.requestFullscreen());
  }

  #listen() {
    const { signal } = this.listening;
    const on = (target, name, react, options = {}) =>
      target.addEventListener(name, (event) => react.call(this, event), { signal, ...options });
    const stage = this.stage;
    const capture = { capture: true };
    on(stage, "pointerdown", this.down, capture);
    on(stage, "pointermove", this.move, capture);
    on(stage, "pointerup", this.up, capture);
    on(stage, "pointercancel", this.up, capture);
    on(stage, "lostpointercapture", this.lost, capture);
    on(stage, "pointerleave", () => this.hover(null));
    on(stage, "focusout", () => this.choose(null));
    // what the hand has taken does not turn the camera
    for (const name of ["mousedown", "touchstart"])
      on(stage, name, (event) => this.taken && event.stopPropagation(), capture);
    on(stage, "wheel", this.wheel, { capture: true, passive: true });
    on(document, "scroll", () => (this.rested = performance.now()), { capture: true, passive: true });
    on(window, "keydown", this.key, capture);
    on(window, "resize", this.fit);
    on(document, PULL, this.follow);
    on(document, TELL, () => {
      this.tell.now();
      this.endSteps();
    });
    const redraw = () => this.redraw();
    const orbit = this.orbit.obj;
    orbit.addEventListener("change", redraw);
    signal.addEventListener("abort", () => orbit.removeEventListener("change", redraw));
    const heard = {
      "msg:custom": (message, buffers) => this.answer(message, buffers),
      "change:settled": () => this.settle(this.model.get("settled")),
      "change:pins": () => {
        if (!this.drag && !this.pinned().includes(this.chosen)) this.choose(null); // it is gone
        redraw();
      },
      "change:size": () => this.fit(),
    };
    for (const [name, react] of Object.entries(heard)) {
      this.model.on(name, react);
      signal.addEventListener("abort", () => this.model.off(name, react));
    }
    const shown = () => {
      const drag = this.drag?.answer ? this.drag : this.sliding();
      drag ? this.draw(drag) : redraw();
    };
    this.skin.position.on("change", shown); // after pythreejs has heard of it
    signal.addEventListener("abort", () => this.skin.position.off("change", shown));
    const theme = new MutationObserver(() => this.tint());
    theme.observe(document.body, { attributeFilter: ["data-jp-theme-light"] });
    signal.addEventListener("abort", () => theme.disconnect());
    this.tint();
    const page = this.stage.closest(".facelab-stage");
    const said = new MutationObserver(() => this.note(page));
    if (page) said.observe(page, { childList: true, subtree: true });
    on(document, "fullscreenchange", () => this.note(page));
    signal.addEventListener("abort", () => said.disconnect());
    const sized = new ResizeObserver(() => this.fit());
    sized.observe(this.stage);
    signal.addEventListener("abort", () => sized.disconnect());
  }

  // Behind the face it is as light or dark as the page.
  tint() {
    const dark = document.body.dataset.jpThemeLight === "false";
    this.el.classList.toggle("facelab-dark", dark);
    const { scene } = this.view; // of all views of this face
    scene.userData.light ??= scene.background.getStyle();
    scene.background.set(dark ? "#26282b" : scene.userData.light);
    this.view.tick();
  }

  // --- camera -----------------------------------------------------------------------------------

  // Where the camera stands in the head frame, its axes (right, up, back), and half its height at 1.
  lens() {
    const camera = this.camera.obj;
    camera.updateMatrixWorld();
    const m = camera.matrixWorld.elements;
    const half = Math.tan((camera.fov * Math.PI) / 360) / camera.zoom;
    return {
      eye: add(this.middle, [m[12], m[13], m[14]]),
      right: [m[0], m[1], m[2]],
      up: [m[4], m[5], m[6]],
      back: [m[8], m[9], m[10]],
      half,
      wide: half * camera.aspect,
    };
  }

  eye() {
    return this.camera.obj.position.toArray();
  }

  lookFrom(way, away = this.model.get("away")) {
    this.camera.obj.position.set(...unit(way).map((x) => x * away));
    this.orbit.obj.update();
    this.orbit.obj.dispatchEvent({ type: "end" }); // so that the kernel knows, too
    this.redraw();
  }

  box() {
    return (this.stage.querySelector("canvas, img") ?? this.stage).getBoundingClientRect();
  }

  // The way of the ray under a spot of the page; not of unit length.
  ray({ x, y }, lens, box = this.box()) {
    const across = (2 * (x - box.left)) / box.width - 1;
    const above = 1 - (2 * (y - box.top)) / box.height;
    return [0, 1, 2].map((a) => across * lens.wide * lens.right[a]
      + above * lens.half * lens.up[a] - lens.back[a]);
  }

  // Where the mouse is in the plane through a point that faces the camera.
  inPlane(event, lens, point, box) {
    const way = this.ray(event, lens, box);
    const t = dot(add(point, lens.eye, -1), lens.back) / dot(way, lens.back);
    return add(lens.eye, way, t);
  }

  // Where a point of the head frame is on the canvas, pixels from its corner.
  onCanvas(point, lens, box = this.box()) {
    const off = add(point, lens.eye, -1);
    const depth = -dot(off, lens.back);
    return [
      (box.width * (1 + dot(off, lens.right) / depth / lens.wide)) / 2,
      (box.height * (1 - dot(off, lens.up) / depth / lens.half)) / 2,
    ];
  }

  // --- what is under the mouse --------------------------------------------------------------------

  // {vertex, point, pin} of the skin, {part: true}, or null.
  find(event) {
    const lens = this.lens();
    const pin = !event.altKey && this.pinAt(event, lens); // Alt reaches past a pin
    if (pin) return pin;
    const way = this.ray(event, lens);
    const { skin } = this;
    const hit = firstHit(lens.eye, way, skin.X, skin.faces, skin.faces.length / 3);
    const part = this.partAt(lens, way);
    const inside = part !== null && !(hit && hit.t < part);
    if (!inside && !hit) return null;
    const point = add(lens.eye, way, inside ? part : hit.t);
    if (inside || hit.face >= skin.nFaces) return this.rimAt(point, lens) ?? { part: true };
    const corners = [0, 1, 2].map((a) => skin.faces[3 * hit.face + a]);
    const away = corners.map((v) => Math.hypot(...add(row(skin.X, v), point, -1)));
    return { vertex: corners[away.indexOf(Math.min(...away))], point };
  }

  pinAt(event, lens) {
    if (!this.model.get("grabs") || !this.model.get("takes_pins")) return null;
    const box = this.box();
    const mouse = [event.x - box.left, event.y - box.top];
    let best = null, least = NEAR;
    for (const [vertex, target] of this.model.get("pins")) {
      for (const point of this.endsOf(vertex, target, lens)) {
        const off = Math.hypot(...add(this.onCanvas(point, lens, box), mouse, -1));
        if (off < least) [best, least] = [{ vertex, point, pin: true }, off];
      }
    }
    return best;
  }

  // The ray's t on a still part such as an eye, or null.
  partAt(lens, way) {
    let first = null;
    for (const { obj } of this.parts) {
      if (!obj.visible) continue;
      const back = new obj.matrixWorld.constructor().getInverse(obj.matrixWorld).elements;
      const local = (p, w) => [0, 1, 2].map((a) =>
        back[a] * p[0] + back[4 + a] * p[1] + back[8 + a] * p[2] + w * back[12 + a]);
      const { index, attributes } = obj.geometry;
      const hit = firstHit(local(add(lens.eye, this.middle, -1), 1), local(way, 0),
        attributes.position.array, index.array, index.array.length / 3);
      if (hit && (first === null || hit.t < first)) first = hit.t;
    }
    return first;
  }

  // A ray that just misses a lid or lip goes on into the opening.
  rimAt(point, lens) {
    let best = null, least = RIM;
    for (const vertex of this.skin.rim) {
      const at = row(this.skin.X, vertex);
      const off = add(at, point, -1);
      const away = Math.hypot(dot(off, lens.right), dot(off, lens.up));
      if (away < least) [best, least] = [{ vertex, point: at }, away];
    }
    return best;
  }

  seen(vertex, lens) {
    const away = add(lens.eye, row(this.skin.X, vertex), -1);
    return dot(row(this.skin.N, vertex), away) > -AVERTED * Math.hypot(...away);
  }

  // Whether no skin is before a point, but for that which it may lie beneath.
  clear(point, lens) {
    const way = add(point, lens.eye, -1);
    const { X, faces } = this.skin;
    const hit = firstHit(lens.eye, way, X, faces, faces.length / 3);
    return !hit || (1 - hit.t) * Math.hypot(...way) < BENEATH;
  }

  // The ends of a pin that are in view, its target and its skin; of many pins quickly, by normals.
  endsOf(vertex, target, lens) {
    const skin = row(this.skin.X, vertex);
    if (this.model.get("pins").length > MANY) return this.seen(vertex, lens) ? [target, skin] : [];
    return [target, skin].filter((point) => this.clear(point, lens));
  }

  nameOf(vertex) {
    const named = this.model.get("pins").find(([v]) => v === vertex)?.[3];
    if (named) return named;
    const table = this.model.get("names");
    if (!table.length) return `vertex ${vertex}`;
    this.codes ??= typed(Uint32Array, this.model.get("name_of"));
    return table[this.codes[vertex]] || `vertex ${vertex}`;
  }

  hover(event) {
    if (!["hovers", "grabs"].some((name) => this.model.get(name)) && !this.model.get("names").length)
      return;
    const before = this.under?.vertex;
    this.under = event && this.find(event);
    const vertex = this.under?.vertex ?? null;
    if (vertex !== (before ?? null)) {
      const chosen = this.pinned().includes(this.chosen); // keys act on that
      if (this.model.get("hovers") && !chosen) this.tell.soon({ do: "hover", vertex });
      this.redraw();
    }
    this.say(vertex === null ? "" : this.nameOf(vertex), event);
  }

  say(text, event) {
    if (this.label.textContent !== text) this.label.textContent = text;
    if (!event || !text) return;
    const box = this.stage.getBoundingClientRect();
    const left = Math.min(event.x - box.left + 14, box.width - this.label.offsetWidth - 4);
    this.label.style.transform = `translate(${left}px, ${event.y - box.top + 16}px)`;
  }

  // What the page says below its faces cannot be seen there in full screen.
  note(page) {
    const full = page && document.fullscreenElement === this.stage;
    const said = full ? page.querySelectorAll(".facelab-error, .facelab-status") : [];
    const text = [...said].map((e) => e.innerText).filter(Boolean).join("\n");
    if (this.notes.textContent !== text) this.notes.textContent = text;
  }

  // --- press, move, release -----------------------------------------------------------------------

  down(event) {
    if (event.target.closest("button")) return;
    if (this.drag && !this.stepping) return; // a second finger
    this.endSteps();
    this.choose(null);
    this.taken = false;
    this.stage.querySelector("canvas")?.focus({ preventScroll: true });
    if (event.button || event.ctrlKey || !this.model.get("grabs") || this.drag) return;
    const found = this.find(event);
    if (!found) return;
    this.taken = true;
    event.target.setPointerCapture?.(event.pointerId);
    if (found.part) {
      this.say("Not skin: pull the skin beside it.", event);
      return;
    }
    const lens = this.lens();
    const box = this.box(); // as it is now: that the canvas grows or moves pulls nothing
    // where the mouse is, as far away as what it takes: a pin near it does not jump to it
    this.grip = { lens, box, pointer: event.pointerId, point: this.inPlane(event, lens, found.point, box) };
    this.begin(found.vertex, event.shiftKey || this.model.get("along_normal"));
  }

  begin(vertex, along) {
    const press = newName();
    hush(this.view.scene); // what has come since
    const before = [...this.let.values()].filter(({ foreign }) => !foreign).map(end);
    this.drag = { press, vertex, before, offset: [0, 0, 0], moved: false };
    this.drag.rail = along && this.railOf(vertex);
    this.lastPin = vertex;
    this.tell.now({ do: "press", ...about(this.drag) });
    this.redraw();
  }

  // For a pull along the normal: the mouse's way that counts, and the normal. The vertex stays
  // under the mouse where the normal is seen from the side. Where it points at the viewer, moving
  // the mouse up pulls outwards.
  railOf(vertex) {
    const normal = row(this.skin.N, vertex);
    const { right, up } = this.lens();
    const [x, y] = [dot(normal, right), dot(normal, up)];
    const length = Math.hypot(x, y);
    const seen = add(right.map((r) => r * x), up, y);
    return { across: length > 0.4 ? seen.map((s) => s / length ** 2) : up, normal };
  }

  // How far the mouse has gone in the plane through the grip that faces the camera, and that not
  // beyond the edge of the canvas: out there no face can follow.
  offsetAt(event) {
    const { lens, point, box } = this.grip;
    const within = { x: clamp(event.x, box.left, box.right), y: clamp(event.y, box.top, box.bottom) };
    const offset = add(this.inPlane(within, lens, point, box), point, -1);
    const { rail } = this.drag;
    return rail ? rail.normal.map((x) => x * dot(offset, rail.across)) : offset;
  }

  move(event) {
    this.rested = performance.now();
    if (!this.drag || this.stepping) {
      if (!event.buttons) this.hover(event);
      return;
    }
    if (event.pointerId !== this.grip.pointer) return;
    if (!event.buttons) return this.lost(event);
    this.pull(this.offsetAt(event));
    this.say(this.nameOf(this.drag.vertex), event);
  }

  pull(offset) {
    const { drag } = this;
    drag.moved ||= Math.hypot(...offset) >= STILL || Boolean(this.stepping);
    if (!drag.moved) return;
    drag.offset = offset;
    this.tell.soon({ do: "move", ...about(drag), offset });
    this.draw();
  }

  up(event) {
    if (!this.drag || this.stepping) {
      this.taken = false;
      return;
    }
    if (event.pointerId !== this.grip.pointer) return;
    if (event.type === "pointerup") this.pull(this.offsetAt(event));
    this.letGo();
    this.taken = false;
    this.hover(event);
  }

  // The button went up where the page did not hear of it.
  lost(event) {
    if (!this.drag || this.stepping || event.pointerId !== this.grip.pointer) return;
    this.letGo();
    this.taken = false;
  }

  letGo() {
    this.tell.now({ ...about(this.drag), ...end(this.drag) });
    this.let.set(this.drag.press, this.drag);
    this.drag = null;
    this.redraw();
  }

  // --- keys and wheel -----------------------------------------------------------------------------

  // The vertices of the pins, where keys may work on them; none while the mouse has one.
  pinned() {
    const free = this.model.get("grabs") && this.model.get("takes_pins") && (!this.drag || this.stepping);
    return free ? this.model.get("pins").map(([vertex]) => vertex) : [];
  }

  // Tab goes from pin to pin, and past the last one on to what follows the face.
  tab(event) {
    const pins = this.pinned();
    const at = pins.indexOf(this.chosen) + (event.shiftKey ? -1 : 1);
    this.endSteps();
    if (event.altKey || event.ctrlKey || event.metaKey || at >= pins.length || at < -1) return this.choose(null);
    event.preventDefault();
    event.stopImmediatePropagation();
    this.choose(at < 0 ? null : pins[at]);
  }

  choose(vertex) {
    if (vertex === this.chosen) return;
    this.chosen = vertex;
    if (this.model.get("hovers")) this.tell.now({ do: "hover", vertex: vertex ?? this.under?.vertex ?? null });
    const pins = this.pinned();
    if (vertex === null) this.say("");
    else {
      this.lastPin = vertex;
      const [x, y] = this.onCanvas(this.model.get("pins")[pins.indexOf(vertex)][1], this.lens());
      const { left, top } = this.box();
      this.say(`pin ${pins.indexOf(vertex) + 1} of ${pins.length}: ${this.nameOf(vertex)}`, { x: left + x, y: top + y });
    }
    this.redraw();
  }

  key(event) {
    const here = document.activeElement?.localName === "canvas" && this.stage.contains(document.activeElement);
    if (here && event.key === "Tab") return this.tab(event);
    if (here && event.key === "Escape" && this.chosen !== null) {
      event.stopImmediatePropagation();
      return this.choose(null);
    }
    const ways = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const way = ways[event.key];
    if (!way || !this.stage.contains(document.activeElement)) return;
    const pins = this.pinned();
    const vertex = pins.includes(this.lastPin) ? this.lastPin : pins.at(-1);
    if (vertex === undefined) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (!this.stepping) {
      this.stepping = true;
      this.begin(vertex, false);
    }
    const { right, up } = this.lens();
    const by = STEP * (event.shiftKey ? 4 : 1);
    this.pull(add(add(this.drag.offset, right, by * way[0]), up, by * way[1]));
    clearTimeout(this.stepping);
    this.stepping = setTimeout(() => this.endSteps(), PAUSE);
  }

  endSteps() {
    if (!this.stepping) return;
    clearTimeout(this.stepping);
    this.stepping = 0;
    this.letGo();
  }

  wheel(event) {
    const since = performance.now() - this.rested;
    const here = document.fullscreenElement || event.ctrlKey || event.altKey
      || (since >= REST && this.under);
    if (!here) {
      this.rested = performance.now();
      event.stopPropagation(); // the page scrolls
    }
  }

  // --- what the kernel says -----------------------------------------------------------------------

  answer(message, buffers) {
    if (!["answer", "slide"].includes(message.do)) return;
    const told = { ...message };
    message.buffers.forEach((name, i) => {
      const Kind = name === "D" ? Float32Array : Float64Array;
      told[name] = typed(Kind, buffers[i]);
    });
    if (told.kind === "bounded") told.basis = this.basis();
    told.base = Float32Array.from(this.skin.told);
    told.moved = follower(told);
    if (message.do === "slide") return this.slide(told);
    let drag = [this.drag, ...this.let.values()].find((d) => d?.press === message.press);
    if (!drag) { // pulled in another view
      drag = { press: message.press, vertex: message.vertex, offset: [0, 0, 0], foreign: true };
      this.let.set(drag.press, drag);
    }
    drag.answer = told;
    this.draw(drag);
  }

  // A slider goes through faces that the kernel has told: the page draws them.
  async slide(answer) {
    const slider = await this.model.widget_manager.get_model(answer.slider);
    const n = answer.n_changes;
    const slide = { press: answer.press, vertex: null, foreign: true, answer };
    const follow = () => {
      const k = slider.get("index");
      answer.pull = answer.shares.subarray(n * k, n * (k + 1));
      this.draw(slide);
    };
    slider.on("change:index", follow);
    slide.over = () => slider.off("change:index", follow);
    this.let.set(slide.press, slide);
    follow();
  }

  sliding() {
    return [...this.let.values()].find((drag) => drag.over);
  }

  basis() {
    const told = this.model.get("basis");
    if (this.basisTold !== told) {
      this.basisTold = told;
      this.basisHere = { rows: typed(Float32Array, told.rows), weights: sparse(told.weights) };
    }
    return this.basisHere;
  }

  // Draw what is pulled, as soon as it is known how the face follows.
  draw(drag = this.drag) {
    const { answer, offset } = drag;
    if (answer) {
      if (answer.target) answer.pull = capped(add(offset, answer.ahead), answer.target, answer.ball);
      this.skin.draw(answer.base, answer.moved, answer.pull);
      this.view.tick();
    }
    this.redraw();
    if (!drag.foreign) this.spread({ press: drag.press, offset, drawn: Boolean(answer) });
  }

  spread(detail) {
    document.dispatchEvent(new CustomEvent(PULL, { detail }));
  }

  follow({ detail: { press, offset, over } }) {
    const drag = this.let.get(press);
    if (!drag?.foreign) return;
    if (over) return this.settle(press);
    drag.offset = offset;
    this.draw(drag);
  }

  // The kernel has dealt with a pull: what it sent is what is shown.
  settle(press) {
    if (this.drag?.press === press) {
      this.drag = null;
      clearTimeout(this.stepping);
      this.stepping = 0;
    }
    const drag = this.let.get(press);
    this.let.delete(press);
    drag?.over?.();
    if (this.drag?.answer) return this.draw();
    this.skin.rest();
    this.view.tick();
    this.redraw();
    if (!drag?.foreign) this.spread({ press, over: true });
  }

  // --- what is drawn over the canvas --------------------------------------------------------------

  redraw() {
    this.due ||= requestAnimationFrame(() => {
      this.due = 0;
      if (!this.listening.signal.aborted) this.drawMarks();
    });
  }

  drawMarks() {
    if (smoothen(this.view.scene)) this.view.tick();
    this.dress();
    const lens = this.lens();
    const box = this.box();
    const place = (point) => this.onCanvas(point, lens, box).map((x) => x.toFixed(1));
    const made = [];
    const dot_ = (point, r, fill, extra = {}) => {
      const [cx, cy] = place(point);
      made.push(element("circle", { cx, cy, r, fill, ...extra }));
    };
    const held = [this.drag, ...this.let.values()].filter((d) => d && (d.moved || d.foreign) && d.vertex !== null);
    const pins = this.model.get("pins").filter(([v]) => !held.some((d) => d.vertex === v));
    const drawn = pins.map(([vertex, target, color]) => ({ vertex, target, color }));
    for (const { vertex, answer, offset } of held) {
      const start = answer ? add(answer.target, answer.pull) : add(row(this.skin.X, vertex), offset);
      drawn.push({ vertex, target: start, color: "#ffd900", held: true });
    }
    for (const { vertex, target, color, held: always } of drawn) {
      const chosen = vertex === this.chosen;
      if (!always && !chosen && !this.endsOf(vertex, target, lens).length) continue;
      const at = row(this.skin.X, vertex);
      const lit = always || (this.under?.pin && this.under.vertex === vertex);
      const [[x1, y1], [x2, y2]] = [place(at), place(target)];
      made.push(element("line", { x1, y1, x2, y2 }));
      if (chosen) dot_(target, 10, "none", { class: "facelab-chosen-pin" });
      dot_(at, lit ? 4.5 : 3.5, "#0d0d0d");
      dot_(target, lit ? 6.5 : 4.5, color, { class: "facelab-pin", "data-vertex": vertex });
    }
    const { under } = this;
    if (under?.vertex !== undefined && !under.pin && !this.drag)
      dot_(row(this.skin.X, under.vertex), 5, "#ffffffd0", { class: "facelab-hover" });
    this.marks.replaceChildren(...made);
  }

  // A canvas is made anew when the page has too many of them.
  dress() {
    const canvas = this.stage.querySelector("canvas");
    if (!canvas || canvas.hasAttribute("tabindex")) return;
    const label = this.model.get("grabs")
      ? "Face. Pull the skin with the mouse. Tab goes from pin to pin; arrow keys move a pin by half "
        + "a millimetre, with Shift by two."
      : "Face. Turn it with the mouse.";
    const attributes = { tabindex: 0, role: "application", "aria-label": label };
    for (const [key, value] of Object.entries(attributes)) canvas.setAttribute(key, value);
    canvas.style.touchAction = "none";
  }

  // As wide as there is room, and as high as that asks for, but no higher than the window.
  fit() {
    const [width, height] = this.model.get("size");
    const full = document.fullscreenElement === this.stage;
    this.stage.style.maxWidth = full ? "" : `${this.widest}px`;
    this.keepTogether();
    const w = this.stage.clientWidth;
    const h = full ? window.innerHeight
      : Math.round(Math.min((w * height) / width, Math.max(height, HIGHEST * window.innerHeight)));
    const same = h === this.h && width === this.asked;
    this.bar.style.right = `${4 + Math.max(0, w - (this.w ?? w))}px`;
    // a scroll bar that comes and goes with the height is no reason
    if (!w || (same && w === this.w) || (width === this.asked && w > this.w && w < this.w + 20)) return;
    [this.w, this.h, this.asked] = [w, h, width];
    this.bar.style.right = "4px";
    this.stage.style.height = full ? "" : `${h}px`;
    this.renderer.set({ _width: w, _height: h });
    this.camera.set({ aspect: w / h });
    this.camera.save_changes();
    this.view.tick();
    this.redraw();
  }

  get widest() {
    return Math.round(WIDEST * this.model.get("size")[0]);
  }

  // A lab's controls stand beside its faces on a wide page, too.
  keepTogether() {
    const column = this.stage.closest(".facelab-stage");
    if (!column) return;
    const faces = [...column.querySelectorAll(".facelab-face")].map(({ facelab }) => facelab);
    const seen = faces.filter((hand) => hand?.stage.clientWidth);
    if (!seen.length) return; // another page is before this one
    column.style.maxWidth = `${seen.reduce((sum, { widest }) => sum + widest + GAP, 0)}px`;
  }

  close() {
    this.listening.abort();
  }
}

async function found(model, el, signal) {
  const get = (id) => model.widget_manager.get_model(id);
  const ids = model.get("ids");
  const [renderer, camera, orbit, face, position, normal] = await Promise.all(
    ["renderer", "camera", "orbit", "face", "position", "normal"].map((name) => get(ids[name])));
  const parts = await Promise.all(ids.parts.map(get));
  while (!signal.aborted) {
    const stage = el.closest(".facelab-face");
    const views = stage ? await Promise.all(Object.values(renderer.views ?? {})) : [];
    const view = views.find((v) => stage.contains(v.el));
    if (view?.camera) {
      const skin = new Skin(model, face, position, normal);
      return { renderer, camera, orbit, parts, stage, view, skin };
    }
    await new Promise(requestAnimationFrame);
  }
  return null;
}

export default {
  initialize: stayInTouch,
  render({ model, el }) {
    const ended = new AbortController();
    let hand = null;
    el.classList.add("facelab-hand");
    found(model, el, ended.signal).then((parts) => {
      if (parts && !ended.signal.aborted) hand = new Hand(model, el, parts);
    });
    return () => {
      ended.abort();
      hand?.close();
    };
  },
};
