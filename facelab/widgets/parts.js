// Small parts that ipywidgets lacks: keys under the mouse, and lists with pictures and buttons.

const EDITABLE = "input, textarea, select, [contenteditable=true], .cm-editor";

// Keys go to the lab that the mouse is over, unless a text is being edited; JupyterLab's own
// shortcuts would else cut and delete cells.
function keys({ model, el }) {
  el.style.display = "none";
  let root = null;
  let over = false;
  const listen = new AbortController();
  const on = (target, name, react, capture = false) =>
    target.addEventListener(name, react, { signal: listen.signal, capture });

  const attach = () => {
    if (listen.signal.aborted) return;
    root = el.closest("." + model.get("root"));
    if (!root) return requestAnimationFrame(attach);
    on(root, "pointerenter", () => (over = true));
    on(root, "pointerleave", () => (over = false));
    on(root, "pointerdown", (event) => {
      over = true;
      const editing = document.activeElement?.closest(EDITABLE);
      if (!event.target.closest(EDITABLE) && editing) document.activeElement.blur();
      if (event.target.localName !== "canvas") model.send({ press: true });
    }, true);
  };
  attach();

  on(window, "keydown", (event) => {
    const typing = event.target.closest?.(EDITABLE);
    if (!over || !root?.isConnected || typing || event.metaKey || event.altKey) return;
    let key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (key === " ") key = "Space";
    if (event.ctrlKey) key = "Ctrl+" + key;
    if (event.shiftKey && key.length > 1) key = "Shift+" + key;
    if (!model.get("heard").includes(key)) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    model.send({ key });
  }, true);
  return () => listen.abort();
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
  const draw = () => {
    const items = model.get("items");
    const rows = items.map((item, index) => {
      const row = element("div", "facelab-item");
      row.classList.toggle("facelab-chosen", index === model.get("chosen"));
      row.title = item.tip ?? "";
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
        button.setAttribute("aria-label", tip);
        button.classList.toggle("facelab-pressed", Boolean(pressed));
        button.addEventListener("click", (event) => {
          event.stopPropagation();
          model.send({ do: name, item: item.id });
        });
        row.append(button);
      }
      row.addEventListener("click", () => model.send({ do: "choose", item: item.id }));
      return row;
    });
    el.replaceChildren(...rows);
    if (!items.length && model.get("empty"))
      el.replaceChildren(element("span", "facelab-note", model.get("empty")));
  };
  el.classList.add("facelab-list", "facelab-" + model.get("shape"));
  draw();
  model.on("change:items", draw);
  model.on("change:chosen", draw);
  return () => {
    model.off("change:items", draw);
    model.off("change:chosen", draw);
  };
}

export default { render: (context) => (context.model.get("kind") === "keys" ? keys : list)(context) };
