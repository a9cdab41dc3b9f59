// Time, buttons, keys: what holds picture and curves together.
"use strict";

Replay.SPEEDS = [1 / 16, 1 / 8, 1 / 4, 1 / 2, 1, 2, 4];
Replay.FRAME = 0.02; // s that an arrow key goes on
Replay.PRINTED = 450; // pixels of a curve's width on paper, before it is fitted into its column
Replay.CAMERAS = ["orbit", "follow", "side", "top", "pad"];

Replay.Player = class {
  constructor(content) {
    this.flights = content.flights.map((packed, k) => new Replay.Flight(packed, k));
    this.scenes = content.scenes;
    this.shown = this.flights.map(() => true);
    this.selected = 0;
    this.time = 0;
    this.playing = false;
    this.speed = 1;
    this.switches = { trail: true, copies: false, forces: true, goal: true, large: true };
    this.calm = matchMedia("(prefers-reduced-motion: reduce)");
    this.dark = matchMedia("(prefers-color-scheme: dark)");
    this.part = (name) => document.getElementById(name);
    this.colours = this.flights.map((_, k) => `--flight-${k % 4}`);
    this.curves = new Replay.Curves(this.part("curves"), (time) => this.seek(time));
    this.stage = this.open();
    this.list();
    this.controls();
    this.keys();
    this.select(0);
    this.print();
    this.fromAddress();
    addEventListener("hashchange", () => this.fromAddress());
    document.documentElement.dataset.ready = this.stage ? "3d" : "curves";
  }

  colour(k) {
    return getComputedStyle(document.documentElement).getPropertyValue(this.colours[k]).trim();
  }

  // The picture, or null where the browser draws none: a sentence stands there then.
  open() {
    const canvas = this.part("picture");
    let stage = null;
    try {
      const colours = this.flights.map((_, k) => new THREE.Color(this.colour(k)));
      stage = new Replay.Stage(canvas, this.flights, this.scenes, colours);
    } catch (error) {
      console.info(`no 3D picture: ${error.message}`);
      canvas.hidden = true;
      this.part("flat").hidden = false;
      for (const element of document.querySelectorAll(".needs-3d")) element.hidden = true;
      return null;
    }
    this.cameras = new Replay.Cameras(canvas, this.flights, this.scenes);
    const look = () => {
      stage.look(this.dark.matches ? "dark" : "light");
      this.refresh();
    };
    this.dark.addEventListener("change", look);
    stage.look(this.dark.matches ? "dark" : "light");
    const fit = () => {
      const box = canvas.parentElement.getBoundingClientRect();
      if (!box.width || !box.height) return;
      const first = !this.fitted;
      this.fitted = true;
      stage.resize(box.width, box.height, Math.min(devicePixelRatio, 2));
      const before = this.cameras.aspect;
      this.cameras.resize(box.width / box.height);
      if (first || Math.abs(before - this.cameras.aspect) > 0.05) this.view(this.cameras.name);
      this.refresh();
    };
    new ResizeObserver(fit).observe(canvas.parentElement);
    for (const controls of [this.cameras.free, this.cameras.pan]) controls.addEventListener("change", () => this.refresh());
    this.stage = stage;
    fit();
    return stage;
  }

  // On paper: a copy of the picture as it is now, in its light look, and curves in two columns.
  print() {
    const draw = (look, width) => {
      this.curves.draw(width);
      if (!this.stage) return;
      this.stage.look(look);
      this.draw();
      const [still, picture] = [this.part("still"), this.part("picture")];
      Object.assign(still, { width: picture.width, height: picture.height });
      still.getContext("2d").drawImage(picture, 0, 0);
    };
    addEventListener("beforeprint", () => draw("light", Replay.PRINTED));
    addEventListener("afterprint", () => draw(this.dark.matches ? "dark" : "light"));
  }

  get end() {
    const seen = this.flights.filter((_, k) => this.shown[k] || k === this.selected);
    return Math.max(...seen.map((flight) => flight.end), 1e-3);
  }

  // --- flights ---------------------------------------------------------------------------------------------

  list() {
    const list = this.part("flights");
    this.rows = this.flights.map((flight, k) => {
      const row = Replay.element("li");
      const pick = Replay.element("button", { type: "button", class: "pick" });
      pick.append(Replay.element("i", { style: `background: var(${this.colours[k]})` }));
      const words = Replay.element("span");
      words.append(Replay.element("b", {}, flight.name), Replay.element("small", {}, flight.outcome));
      pick.append(words);
      pick.addEventListener("click", () => this.select(k));
      row.append(pick);
      if (this.flights.length > 1) {
        const label = Replay.element("label", { class: "needs-3d", title: "in the picture" });
        const box = Replay.element("input", { type: "checkbox", "aria-label": `show ${flight.name}` });
        box.checked = true;
        box.addEventListener("change", () => this.include(k, box.checked));
        label.append(box);
        row.append(label);
      }
      list.append(row);
      return { row, pick };
    });
  }

  // Put a flight into the picture or leave it out.
  include(k, on) {
    this.shown[k] = on;
    const box = this.rows[k].row.querySelector("input");
    if (box) box.checked = on;
    this.curves.show(...this.pair(), this.end);
    this.range();
    this.seek(this.time);
  }

  // The flight whose curves are shown, and the other one of a measured and a simulated flight.
  pair() {
    const at = this.selected;
    const measured = this.flights[at].kind === "simulated" ? at - 1 : at;
    const next = this.flights[measured + 1];
    return next && next.kind === "simulated" ? [this.flights[measured], next] : [this.flights[at], null];
  }

  select(k) {
    this.selected = k;
    this.rows.forEach(({ row, pick }, n) => {
      row.classList.toggle("selected", n === k);
      pick.setAttribute("aria-pressed", String(n === k));
    });
    const [first, other] = this.pair();
    const own = this.part("curves").style;
    own.setProperty("--a", `var(${this.colours[first.number]})`);
    own.setProperty("--b", `var(${this.colours[other ? other.number : (first.number + 1) % 4]}, var(--flight-1))`);
    if (!other) own.setProperty("--b", `var(--flight-${(first.number + 1) % 4})`);
    own.setProperty("--c", `var(--flight-${(first.number + 2) % 4})`);
    this.curves.show(first, other, this.end);
    this.range();
    if (this.stage) {
      this.stage.select(k);
      if (["follow", "pad"].includes(this.cameras.name)) this.view(this.cameras.name);
    }
    this.seek(this.time);
  }

  // --- time ------------------------------------------------------------------------------------------------

  range() {
    const slider = this.part("time");
    slider.max = this.end;
    const marks = this.flights[this.selected].events.map(([t, name]) => {
      const mark = Replay.element("span", { title: `${name} at ${t.toFixed(2)} s` });
      mark.style.left = `${(100 * t) / this.end}%`;
      return mark;
    });
    this.part("marks").replaceChildren(...marks);
  }

  seek(time) {
    this.time = Math.min(this.end, Math.max(0, time));
    this.curves.update(this.time);
    const slider = this.part("time");
    slider.value = this.time;
    slider.style.setProperty("--done", `${(100 * this.time) / this.end}%`);
    slider.setAttribute("aria-valuetext", `${this.time.toFixed(2)} of ${this.end.toFixed(2)} seconds`);
    this.part("clock").textContent = `${this.time.toFixed(2)} s`;
    this.part("length").textContent = `/ ${this.end.toFixed(2)} s`;
    this.part("now").textContent = this.words();
    this.refresh();
  }

  // What is said of the selected flight at this moment.
  words() {
    const flight = this.flights[this.selected];
    const time = Math.min(this.time, flight.end);
    const k = flight.row(time);
    const [x, y, z] = [0, 1, 2].map((c) => Replay.number(flight.at(flight.position, 3, c, time), 2));
    const speed = Math.hypot(...flight.velocity.subarray(3 * k, 3 * k + 3)).toFixed(2);
    const words = [`x ${x}`, `y ${y}`, `z ${z} m`, `${speed} m/s`];
    if (flight.contacts && flight.net(k) > 0) words.push(`contact ${flight.net(k).toFixed(2)} N`);
    const past = flight.events.filter(([t]) => t <= time + 1e-6);
    if (past.length) words.push(past[past.length - 1][1]);
    return words.join("   ");
  }

  play(on) {
    if (on === this.playing) return;
    this.playing = on;
    const button = this.part("play");
    button.setAttribute("aria-label", on ? "pause" : "play");
    button.classList.toggle("on", on);
    if (!on) return;
    if (this.time >= this.end - 1e-6) this.seek(0);
    let before = performance.now();
    const tick = (now) => {
      if (!this.playing) return;
      const time = this.time + (this.speed * Math.min(now - before, 250)) / 1000;
      before = now;
      this.seek(time);
      if (time >= this.end) this.play(false);
      else requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  // --- picture ---------------------------------------------------------------------------------------------

  refresh() {
    if (!this.stage || this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => this.draw());
  }

  draw() {
    this.waiting = false;
    this.cameras.follow(this.time, this.selected);
    this.stage.update(this.time, { ...this.switches, shown: this.shown, still: this.calm.matches });
    this.stage.render(this.cameras.camera);
  }

  view(name) {
    if (!this.stage) return;
    this.cameras.time = this.time;
    this.cameras.use(name, this.shown, this.selected);
    for (const button of this.part("cameras").children) {
      button.setAttribute("aria-pressed", String(button.dataset.camera === name));
    }
    this.refresh();
  }

  toggle(name, on = !this.switches[name]) {
    this.switches[name] = on;
    this.part(name).setAttribute("aria-pressed", String(on));
    this.refresh();
  }

  // --- hands -----------------------------------------------------------------------------------------------

  controls() {
    this.part("play").addEventListener("click", () => this.play(!this.playing));
    this.part("time").addEventListener("input", (event) => this.seek(Number(event.target.value)));
    this.part("speed").addEventListener("change", (event) => (this.speed = Number(event.target.value)));
    for (const button of this.part("cameras").children) {
      button.addEventListener("click", () => this.view(button.dataset.camera));
    }
    for (const name of Object.keys(this.switches)) this.part(name).addEventListener("click", () => this.toggle(name));
    for (const [name, there] of [["goal", "goal"], ["forces", "contacts"]]) {
      this.part(name).hidden = !this.flights.some((flight) => flight[there]);
    }
    const large = this.scenes[0].scale;
    this.part("large").textContent = `vehicle ${large}×`;
  }

  keys() {
    const step = (seconds) => {
      this.play(false);
      this.seek(this.time + seconds);
    };
    const faster = (by) => {
      const select = this.part("speed");
      const at = Replay.SPEEDS.indexOf(this.speed) + by;
      if (at < 0 || at >= Replay.SPEEDS.length) return;
      this.speed = Replay.SPEEDS[at];
      select.value = String(this.speed);
    };
    const actions = {
      " ": () => this.play(!this.playing),
      k: () => this.play(!this.playing),
      ArrowLeft: (event) => step(event.shiftKey ? -Replay.FRAME / 5 : -Replay.FRAME),
      ArrowRight: (event) => step(event.shiftKey ? Replay.FRAME / 5 : Replay.FRAME),
      Home: () => step(-this.end),
      End: () => step(this.end),
      "[": () => faster(-1),
      "]": () => faster(1),
      t: () => this.toggle("trail"),
      g: () => this.toggle("copies"),
      f: () => this.toggle("forces"),
      o: () => this.toggle("goal"),
      v: () => this.toggle("large"),
      n: () => this.select((this.selected + 1) % this.flights.length),
    };
    Replay.CAMERAS.forEach((name, k) => (actions[String(k + 1)] = () => this.view(name)));
    addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const within = event.target;
      const own = within.matches?.("button, input, select, summary, a") && [" ", "Home", "End"].includes(event.key);
      if (own || within.matches?.("select")) return;
      const action = actions[event.key];
      if (!action) return;
      event.preventDefault();
      action(event);
    });
  }

  // #t=1.2&camera=pad&flight=2&only=1&copies=1&trail=0&forces=0&goal=0&large=0: a moment to link to.
  fromAddress() {
    const given = new URLSearchParams(location.hash.slice(1));
    const flight = Number(given.get("flight"));
    if (Number.isInteger(flight) && flight >= 1 && flight <= this.flights.length) this.select(flight - 1);
    if (given.get("only") === "1") this.rows.forEach((_, k) => this.include(k, k === this.selected));
    const time = Number(given.get("t"));
    if (given.has("t") && Number.isFinite(time)) this.seek(time);
    for (const name of Object.keys(this.switches)) {
      if (given.has(name)) this.toggle(name, given.get(name) === "1");
    }
    if (Replay.CAMERAS.includes(given.get("camera"))) this.view(given.get("camera"));
  }
};

Replay.player = new Replay.Player(JSON.parse(document.getElementById("content").textContent));
