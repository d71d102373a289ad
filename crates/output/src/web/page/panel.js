// The panel: setups, lights, surroundings, view.

const signed = (stops) => `${stops > 0 ? "+" : stops < 0 ? "−" : ""}${Math.abs(stops).toFixed(2)} EV`;

class Panel {
  /** `changed` hears of new light, `viewed` of another way to show it. */
  constructor(light, changed, viewed) {
    this.light = light;
    this.selected = light.setup.lamps.length > 0 ? 0 : -1;
    this.changed = changed;
    this.shown = { exposure: 1, transform: 0, background: [18 / 255, 18 / 255, 18 / 255] };
    this.onLight("stops", (value) => (this.lamp().stops = Number(value)));
    this.onLight("colour", (value) => light.setColour(this.selected, colourOf(value)));
    this.onLight("ambient", (value) => (light.setup.ambient = Number(value)));
    this.on("rest", "change", () => this.edit(() => (light.setup.rest = element("rest").checked)));
    this.on("reset-light", "click", () => {
      light.resetLamp(this.selected);
      this.update();
    });
    this.on("undo", "click", () => this.undo());
    this.on("exposure", "input", () => {
      this.shown.exposure = 2 ** Number(element("exposure").value);
      element("exposure-shown").textContent = signed(Number(element("exposure").value));
      viewed();
    });
    this.on("transform", "change", () => {
      this.shown.transform = Number(element("transform").value);
      viewed();
    });
    element("exposure-shown").textContent = signed(0);
    this.update();
  }

  on(id, event, act) {
    element(id).addEventListener(event, act);
  }

  /** A setting of the light: it follows the input at once, and is one step when that ends. */
  onLight(id, set) {
    this.on(id, "input", () => {
      this.light.begin();
      set(element(id).value);
      this.update();
    });
    this.on(id, "change", () => {
      this.light.commit();
      this.update();
    });
  }

  lamp() {
    return this.light.setup.lamps[this.selected];
  }

  /** One change of the light. */
  edit(change) {
    this.light.begin();
    change();
    this.light.commit();
    this.update();
  }

  undo() {
    this.light.undo();
    this.update();
  }

  select(index) {
    this.selected = index;
    this.update();
  }

  mute(index) {
    this.edit(() => (this.light.setup.lamps[index].muted = !this.light.setup.lamps[index].muted));
  }

  /** Shows the state, and has the picture follow. */
  update() {
    const { light } = this;
    this.selected = Math.min(this.selected, light.setup.lamps.length - 1);
    this.list("setups", light.state.setups, (button, setup, number) => this.setupButton(button, setup, number), "button");
    this.list("lights", light.setup.lamps, (row, lamp, index) => this.lampRow(row, lamp, index), "div");
    this.settings();
    element("undo").disabled = light.undone.length === 0;
    this.changed();
  }

  /** As many children as things, each filled anew: what has the focus keeps it. */
  list(id, things, fill, tag) {
    const box = element(id);
    while (box.children.length > things.length) {
      box.lastChild.remove();
    }
    while (box.children.length < things.length) {
      box.append(document.createElement(tag));
    }
    things.forEach((thing, i) => fill(box.children[i], thing, i));
  }

  setupButton(button, setup, number) {
    button.type = "button";
    button.setAttribute("role", "radio");
    button.setAttribute("aria-checked", number === this.light.state.active);
    button.textContent = setup.name;
    button.title = setup.captured ? "The light that the photographs were taken in" : "Show this setup";
    button.onclick = () => {
      this.light.show(number);
      this.update();
    };
  }

  lampRow(row, lamp, index) {
    const { name } = this.light.givenLamp(index);
    if (row.children.length === 0) {
      row.className = "light";
      const swatch = Object.assign(document.createElement("span"), { className: "swatch" });
      const choose = Object.assign(document.createElement("button"), { className: "name", type: "button", title: "Select this light" });
      const mute = Object.assign(document.createElement("button"), { className: "mute", type: "button", textContent: "M" });
      row.append(swatch, choose, mute);
      choose.onclick = () => this.select(index);
      mute.onclick = () => this.mute(index);
    }
    const [swatch, choose, mute] = row.children;
    row.classList.toggle("dark", lamp.muted);
    row.setAttribute("aria-current", index === this.selected);
    swatch.style.background = hexadecimal(this.light.flux(index));
    choose.textContent = name;
    mute.setAttribute("aria-pressed", lamp.muted);
    mute.setAttribute("aria-label", `Mute ${name}`);
    mute.title = lamp.muted ? "Switch this light on" : "Switch this light off";
  }

  settings() {
    const { light } = this;
    const lamp = this.lamp();
    element("settings").hidden = !lamp;
    if (lamp) {
      element("selected").textContent = light.givenLamp(this.selected).name;
      element("stops").value = lamp.stops;
      element("stops-shown").textContent = signed(lamp.stops);
      const hue = hexadecimal(light.flux(this.selected));
      if (document.activeElement !== element("colour")) {
        element("colour").value = hue;
      }
      element("reset-light").disabled = light.isOwn(this.selected);
    }
    element("ambient").disabled = !light.hasAmbient();
    element("ambient").value = light.setup.ambient;
    element("ambient-shown").textContent = light.hasAmbient() ? `× ${light.setup.ambient.toFixed(2)}` : "none";
    element("rest-row").hidden = !light.hasRest();
    element("rest").checked = light.setup.rest;
  }
}
