// Small parts that ipywidgets lacks: keys under the mouse, lists with pictures and buttons, sliders
// that never answer for the person, and a line of time with keys to drag.

const EDITABLE = "input:not([type=range]), textarea, select, [contenteditable=true], .cm-editor";
const PLAYER = { play: "Play", pause: "Pause", stop: "Stop", retweet: "Repeat" };
const OWN_KEYS = [" ", "Enter", "ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown"];
const AGAIN = ["Undo", "Redo"]; // buttons of which a double click is two

// Keys go to the lab that the mouse is over, unless a text is being edited; JupyterLab's own
// shortcuts would else cut and delete cells.
function keys({ model, el }) {
  el.style.display = "none";
  let root = null;
  let over = false;
  const listen = new AbortController();
  const on = (target, name, react, capture = false) =>
    target.addEventListener(name, react, { signal: listen.signal, capture });

  // What ipywidgets leaves unsaid for those who hear the page: what a slider is, what is pressed.
  const speak = () => {
    for (const box of root?.querySelectorAll(".widget-inline-hbox") ?? []) {
      // that of a checkbox is a sign without width; it is called after the text beside it
      const name = box.querySelector(".widget-label")?.textContent.replace(/\u200b/g, "").trim();
      for (const handle of name ? box.querySelectorAll(".noUi-handle, input, select") : [])
        if (handle.getAttribute("aria-label") !== name) handle.setAttribute("aria-label", name);
    }
    for (const [sign, name] of Object.entries(PLAYER))
      for (const button of root?.querySelectorAll(`.widget-play button:has(.fa-${sign})`) ?? [])
        if (button.getAttribute("aria-label") !== name) {
          button.setAttribute("aria-label", name);
          button.title = name;
        }
    for (const select of root?.querySelectorAll("select[title]:not([aria-label])") ?? [])
      select.setAttribute("aria-label", select.title); // its own label may be empty
    for (const button of root?.querySelectorAll(".widget-toggle-button") ?? []) {
      const pressed = String(button.classList.contains("mod-active"));
      if (button.getAttribute("aria-pressed") !== pressed) button.setAttribute("aria-pressed", pressed);
    }
  };
  const watch = new MutationObserver(speak);

  // A widget keeps a change back while its last one is under way: over a slow wire, or to a busy
  // kernel, what the person does next would overtake it.
  let controls = [];
  Promise.all(model.get("controls").map((id) => model.widget_manager.get_model(id)))
    .then((found) => (controls = found));
  const tellAll = () => {
    document.dispatchEvent(new Event(TELL));
    for (const control of controls) {
      if (!control._msg_buffer) continue;
      const id = control.send_sync_message(control._msg_buffer, control._msg_buffer_callbacks);
      control.rememberLastUpdateFor?.(id);
      control._msg_buffer = control._msg_buffer_callbacks = null;
    }
  };

  const attach = () => {
    if (listen.signal.aborted) return;
    root = el.closest("." + model.get("root"));
    if (!root) return requestAnimationFrame(attach);
    speak();
    watch.observe(root, { subtree: true, childList: true, attributes: true, attributeFilter: ["class"] });
    on(root, "focusin", () => (over = true));
    on(root, "focusout", (event) => (over = root.contains(event.relatedTarget) || root.matches(":hover")));
    on(root, "pointerenter", () => (over = true));
    on(root, "pointerleave", () => (over = root.contains(document.activeElement)));
    on(root, "pointerdown", (event) => {
      over = true;
      const editing = document.activeElement?.closest(EDITABLE);
      if (!event.target.closest(EDITABLE) && editing) document.activeElement.blur();
      tellAll();
      if (event.target.localName !== "canvas") model.send({ press: true });
    }, true);
    on(root, "keydown", (event) => event.key === "Enter" && tellAll(), true);
    on(root, "click", (event) => {
      const button = event.target.closest(".widget-button");
      if (event.detail > 1 && button && !AGAIN.includes(button.textContent.trim()))
        event.stopImmediatePropagation();
      tellAll();
    }, true);
  };
  attach();

  on(window, "keydown", (event) => {
    const typing = event.target.closest?.(EDITABLE);
    // a button or a slider that has the focus keeps the keys that work it
    if (root?.contains(document.activeElement) && OWN_KEYS.includes(event.key)) return;
    if (event.key === "Escape" && root?.querySelector(".facelab-chosen-pin")) return; // leaves the pin
    if (!over || !root?.isConnected || typing || event.metaKey || event.altKey) return;
    const hovered = document.querySelector(`.${model.get("root")}:hover`);
    if (hovered && hovered !== root) return; // the mouse is over another lab
    let key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (key === " ") key = "Space";
    if (event.ctrlKey) key = "Ctrl+" + key;
    if (event.shiftKey && key.length > 1) key = "Shift+" + key;
    if (!model.get("heard").includes(key)) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (event.repeat && !/^(Ctrl\+)?[zy]$/.test(key)) return; // held down, it is still one press
    if (key !== "Escape") tellAll(); // that gives up what is under way
    model.send({ key });
  }, true);
  return () => { listen.abort(); watch.disconnect(); };
}

function element(name, className, text = "") {
  const made = document.createElement(name);
  made.className = className;
  made.textContent = text;
  return made;
}

// A list of rows or pictures. Each item: name, note, and of these what it has: color, picture,
// bar (0 to 1) with bar_color, buttons [[name, sign, tip, pressed], ...].
function list({ model, el }) {
  let last = null; // the item clicked on: a double click does nothing to what has taken its place
  const tell = (event, what, item) => {
    event.stopPropagation();
    const own = event.detail < 2 || (item === last && what !== "choose");
    if (own) last = item;
    if (own) model.send({ do: what, item });
  };
  let [gripped, stale] = [false, false]; // a row that goes between down and up hears of no click
  const letGo = () => setTimeout(() => { // after the click
    gripped = false;
    if (stale) draw();
  });
  el.addEventListener("pointerdown", () => {
    gripped = true;
    for (const name of ["pointerup", "pointercancel"])
      window.addEventListener(name, letGo, { capture: true, once: true });
  });
  const draw = () => {
    stale = gripped;
    if (stale) return;
    const items = model.get("items");
    const focused = el.contains(document.activeElement) ? document.activeElement : null;
    const place = [focused?.closest(".facelab-item")?.dataset.id, null, focused?.dataset.do];
    const rows = items.map((item, index) => {
      const row = element("div", "facelab-item");
      row.classList.toggle("facelab-chosen", index === model.get("chosen"));
      row.title = item.tip ?? "";
      if (choosable) {
        row.tabIndex = 0;
        row.dataset.id = item.id;
        row.setAttribute("role", "option");
        row.setAttribute("aria-selected", String(index === model.get("chosen")));
        row.setAttribute("aria-label", [item.name, item.note].filter(Boolean).join(", "));
        row.addEventListener("keydown", (event) => {
          if (event.target !== row || !["Enter", " "].includes(event.key)) return;
          event.preventDefault();
          model.send({ do: "choose", item: item.id });
        });
      }
      if (item.color) {
        const swatch = element("span", "facelab-swatch");
        swatch.style.background = item.color;
        row.append(swatch);
      }
      if (item.picture) {
        const picture = element("img", "facelab-picture");
        picture.src = "data:image/png;base64," + item.picture;
        picture.alt = item.name;
        row.append(picture);
      }
      row.append(element("span", "facelab-name", item.name));
      if (item.bar !== undefined) {
        const bar = element("span", "facelab-bar");
        const filled = element("span", "");
        filled.style.width = 100 * Math.min(item.bar, 1) + "%";
        filled.style.background = item.bar_color;
        bar.append(filled);
        row.append(bar);
      }
      if (item.note) row.append(element("span", "facelab-note", item.note));
      for (const [name, sign, tip, pressed] of item.buttons ?? []) {
        const button = element("button", "facelab-button", sign);
        button.title = tip;
        button.dataset.do = name;
        button.setAttribute("aria-label", tip);
        button.setAttribute("aria-pressed", String(Boolean(pressed)));
        button.classList.toggle("facelab-pressed", Boolean(pressed));
        button.addEventListener("click", (event) => tell(event, name, item.id));
        row.append(button);
      }
      row.addEventListener("click", (event) => tell(event, "choose", item.id));
      return row;
    });
    el.replaceChildren(...rows);
    const again = focused && rows.find((row) => row.dataset.id === place[0]);  // keep the focus
    if (again) ([...again.querySelectorAll("button")].find((b) => b.dataset.do === place[2]) ?? again).focus();
    if (!items.length && model.get("empty"))
      el.replaceChildren(element("span", "facelab-note", model.get("empty")));
  };
  const choosable = model.get("shape") !== "rows";
  el.classList.add("facelab-list", "facelab-" + model.get("shape"));
  el.setAttribute("role", choosable ? "listbox" : "group");
  el.setAttribute("aria-label", model.get("label"));
  draw();
  model.on("change:items", draw);
  model.on("change:chosen", draw);
  return () => {
    model.off("change:items", draw);
    model.off("change:chosen", draw);
  };
}

// Sliders, each with a number to type. Only what a person moves is told; ipywidgets' own sliders
// round and bound what the kernel shows, and send that back as if it had been moved.
function sliders({ model, el }) {
  el.classList.add("facelab-sliders");
  const EVERY = 100; // ms between messages; the last always leaves
  let rows = [];
  let held = null; // the slider that the person moves, until the kernel has dealt with the last of it
  let [gripped, stale] = [false, false]; // the mouse is down on it; other sliders wait to be shown
  let [asked, heard, waiting, timer] = [0, 0, null, null];
  const flush = () => {
    timer = null;
    if (!waiting) return;
    model.send(waiting);
    waiting = null;
    timer = setTimeout(flush, EVERY);
  };
  const tell = (row, value) => {
    held = row;
    row.show(value);
    if (waiting && waiting.item !== row.item.id) model.send(waiting);
    waiting = { item: row.item.id, value, asked: ++asked };
    if (!timer) flush();
  };
  const build = () => {
    stale = held !== null;
    if (stale) return;
    const focused = rows.findIndex(({ made }) => made.contains(document.activeElement));
    const was = rows[focused]?.item.id;
    rows = model.get("items").map((item) => {
      // where a value is along the way of the handle, and back
      const [along, back] = item.log ? [Math.log10, (at) => Number((10 ** at).toPrecision(3))] : [(x) => x, (x) => x];
      const made = element("div", "facelab-slider");
      made.title = item.tip;
      made.append(element("span", "facelab-slider-name", item.name));
      const field = (type, step, low, high) => {
        const input = element("input", "");
        Object.assign(input, { type, min: low, max: high, step });
        input.setAttribute("aria-label", item.name);
        made.append(input);
        return input;
      };
      const range = field("range", 0.01, along(item.low), along(item.high));
      const number = field("number", "any", item.low, item.high);
      const row = { item, made, show: (value) => {
        // a pose may be beyond the usual ends
        range.min = along(Math.min(item.low, value));
        range.max = along(Math.max(item.high, value));
        range.value = along(value);
        const share = (range.value - range.min) / (range.max - range.min);
        range.style.setProperty("--facelab-share", `${100 * share}%`);
        const shown = item.log ? String(Number(value.toPrecision(3))) : value.toFixed(2);
        range.setAttribute("aria-valuetext", shown);
        if (document.activeElement !== number) number.value = shown;
      } };
      range.addEventListener("input", () => tell(row, back(Number(range.value))));
      range.addEventListener("pointerdown", () => {
        gripped = true;
        window.addEventListener("pointerup", () => { gripped = false; settle(); }, { once: true });
      });
      number.dataset.lmSuppressShortcuts = "true"; // JupyterLab takes Enter
      number.addEventListener("keydown", (event) => event.key === "Enter" && number.blur());
      number.addEventListener("focus", () => number.select());
      number.addEventListener("change", () => {
        if (number.value !== "" && number.checkValidity()) tell(row, Number(number.value));
        else draw();
      });
      return row;
    });
    el.style.setProperty("--facelab-accent", model.get("color"));
    el.replaceChildren(...rows.map(({ made }) => made));
    if (was !== undefined) rows.find(({ item }) => item.id === was)?.made.querySelector("input").focus();
    draw();
  };
  const draw = () => rows.forEach((row, i) => row !== held && row.show(model.get("values")[i] ?? 0));
  const settle = () => {
    if (gripped || heard < asked) return;
    held = null;
    if (stale) build();
    else draw();
  };
  const hear = (message) => {
    heard = message.heard;
    settle();
  };
  const tellNow = () => {
    if (!waiting) return;
    clearTimeout(timer);
    flush();
  };
  build();
  model.on("change:items", build);
  model.on("change:values", draw);
  model.on("msg:custom", hear);
  document.addEventListener(TELL, tellNow);
  return () => {
    document.removeEventListener(TELL, tellNow);
    tellNow();
    clearTimeout(timer);
    model.off("change:items", build);
    model.off("change:values", draw);
    model.off("msg:custom", hear);
  };
}

// Key poses on a line of time. A key is dragged, or moved by the arrow keys; a click chooses it.
function track({ model, el }) {
  el.classList.add("facelab-track");
  const line = element("div", "facelab-track-line");
  const now = element("div", "facelab-track-now");
  el.append(line);
  const place = (t) => `${(100 * Math.min(t / model.get("length"), 1)).toFixed(3)}%`;
  const steady = (t) => Math.min(Math.max(Math.round(25 * t) / 25, 0), model.get("length"));
  let held = null;
  let asked = null; // the last message, until the kernel has heard it
  const draw = () => {
    if (held || asked) return;
    const focused = [...line.children].indexOf(document.activeElement);
    const times = model.get("times");
    const keys = times.map((time) => {
      const key = element("button", "facelab-track-key");
      key.style.left = place(time);
      key.title = `Key at ${time.toFixed(2)} s: drag it, or press the arrows`;
      key.setAttribute("aria-label", `key at ${time.toFixed(2)} s`);
      let [from, to] = [time, time];
      const at = (event) => {
        const box = line.getBoundingClientRect();
        return steady(((event.clientX - box.left) / box.width) * model.get("length"));
      };
      // from where the kernel will have it by then, unless another key is in the way
      const tell = () => {
        model.send({ do: to === from ? "choose" : "move", item: from, to, asked: (asked = Math.random()) });
        if (!times.some((t) => t !== time && Math.abs(t - to) < 0.02)) from = to;
        to = from;
        key.style.left = place(to);
      };
      key.addEventListener("pointerdown", (event) => {
        held = key;
        key.setPointerCapture(event.pointerId);
      });
      key.addEventListener("pointermove", (event) => {
        if (held !== key) return;
        to = at(event);
        key.style.left = place(to);
      });
      key.addEventListener("lostpointercapture", () => {
        held = null;
        tell();
      });
      key.addEventListener("keydown", (event) => {
        const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
        if (event.key === "Enter") tell();
        if (!step) return;
        event.preventDefault();
        to = steady(from + step / 25);
        if (to !== from) tell();
      });
      return key;
    });
    now.style.left = place(model.get("now"));
    line.replaceChildren(...keys, now);
    keys[focused]?.focus();
  };
  const stand = () => (now.style.left = place(model.get("now")));
  const hear = ({ heard }) => {
    if (heard !== asked) return;
    asked = null;
    draw();
  };
  draw();
  model.on("change:times", draw);
  model.on("change:length", draw);
  model.on("change:now", stand);
  model.on("msg:custom", hear);
  return () => {
    model.off("change:times", draw);
    model.off("change:length", draw);
    model.off("change:now", stand);
    model.off("msg:custom", hear);
  };
}

const KINDS = { keys, list, sliders, track };
export default { initialize: stayInTouch, render: (context) => KINDS[context.model.get("kind")](context) };
