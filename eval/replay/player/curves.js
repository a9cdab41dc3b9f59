// Commands and what followed them over time, as SVG, with a cursor at the present moment.
"use strict";

Replay.EDGES = { left: 46, right: 14, top: 8, bottom: 8, axis: 24 };
Replay.HEIGHT = 84; // pixels of a panel without its axis

// What is drawn of a flight, and of the other one of its pair: panels of series.
Replay.panels = (flight, other) => {
  const series = (label, colour, from, value, options = {}) => ({ label, colour, flight: from, value, ...options });
  const command = (c, factor = 1) => (k) => factor * flight.commands[4 * k + c];
  const angle = (f, c) => (k) => Replay.degrees(f.attitude[3 * k + c]);
  const speed = (f, c) => (k) => f.velocity[3 * k + c];
  const held = { held: true };
  const said = [["measured", "a"], ["simulated", "b"]];
  const both = other ? [flight, other] : [flight];
  const found = [
    { title: "Thrust command", unit: "10³ PWM", digits: 1, series: [series("command", "a", flight, command(0, 1e-3), held)] },
  ];
  [["Roll", 0, 1], ["Pitch", 1, 2]].forEach(([title, c, sent]) => {
    const lines = both.map((f, n) => series(other ? said[n][0] : "vehicle", other ? said[n][1] : "a", f, angle(f, c)));
    lines.push(series("command", "muted", flight, command(sent, 180 / Math.PI), { ...held, dash: true }));
    if (lines.some((line) => Replay.largest(line) > 0.3)) found.push({ title, unit: "deg", digits: 1, series: lines });
  });
  const axes = ["x", "y", "z"];
  if (other) {
    axes.forEach((axis, c) => {
      const lines = both.map((f, n) => series(said[n][0], said[n][1], f, speed(f, c)));
      found.push({ title: `Velocity in ${axis}`, unit: "m/s", digits: 2, series: lines });
    });
    const apart = Replay.apart(flight, other);
    const line = series("distance", "b", other, (k) => 100 * apart[k]);
    found.push({ title: "Measured to simulated position", unit: "cm", digits: 1, zero: true, series: [line] });
  } else {
    const lines = axes.map((axis, c) => series(`v${axis}`, ["a", "c", "b"][c], flight, speed(flight, c)));
    const moving = lines.filter((line) => Replay.largest(line) > 0.01);
    found.push({ title: "Velocity", unit: "m/s", digits: 2, series: moving.length ? moving : lines });
  }
  if (flight.contacts && flight.strongest > 0) {
    const line = series("net force", "force", flight, (k) => flight.net(k));
    found.push({ title: "Contact force", unit: "N", digits: 2, zero: true, series: [line] });
  }
  return found.filter((panel) => panel.series.some((line) => Number.isFinite(Replay.largest(line))));
};

Replay.largest = (line) => {
  let most = NaN;
  for (let k = 0; k < line.flight.rows; k++) {
    const size = Math.abs(line.value(k));
    if (!(size <= most) && Number.isFinite(size)) most = size;
  }
  return most;
};

// Distance [m] of the simulated from the measured position in every row of the simulated flight.
Replay.apart = (measured, simulated) => {
  const result = new Float32Array(simulated.rows);
  for (let k = 0; k < simulated.rows; k++) {
    const differ = [0, 1, 2].map((c) => simulated.position[3 * k + c] - measured.at(measured.position, 3, c, simulated.t[k]));
    result[k] = Math.hypot(...differ);
  }
  return result;
};

// Round numbers within a range, about `count` of them.
Replay.ticks = (low, high, count) => {
  const rough = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * ([1, 2, 5, 10].find((s) => s * power >= rough * 0.999) || 10);
  const found = [];
  for (let n = Math.ceil(low / step - 1e-9); n * step <= high + 1e-9 * step; n++) found.push(n * step);
  return found;
};

Replay.tick = (value) => String(Number(value.toPrecision(6))).replace("-", "−");

Replay.Curves = class {
  constructor(place, seek) {
    Object.assign(this, { place, seek, panels: [], time: 0, end: 1 });
    new ResizeObserver(() => this.draw()).observe(place);
  }

  // Show a flight, the other one of its pair or null; `end` [s] of the time axis.
  show(flight, other, end) {
    this.end = Math.max(end, 1e-3);
    this.events = flight.events;
    this.content = Replay.panels(flight, other);
    this.place.replaceChildren();
    this.panels = this.content.map((panel, n) => this.panel(panel, n === this.content.length - 1));
    this.width = 0;
    this.draw();
  }

  panel(panel, last) {
    const figure = Replay.element("figure", { class: "panel" });
    const caption = Replay.element("figcaption");
    caption.append(Replay.element("b", {}, `${panel.title} `), Replay.element("span", { class: "unit" }, panel.unit));
    const values = panel.series.map((line) => {
      const item = Replay.element("span", { class: `key ${line.colour}${line.dash ? " dash" : ""}` });
      const value = Replay.element("output", {}, "");
      item.append(Replay.element("i"), `${line.label} `, value);
      caption.append(item);
      return value;
    });
    const names = panel.series.map((line) => line.label).join(", ");
    const svg = Replay.svg("svg", { role: "img", "aria-label": `${panel.title} over time in ${panel.unit}: ${names}` });
    const move = (event) => {
      const box = svg.getBoundingClientRect();
      const { left, right } = Replay.EDGES;
      const share = (event.clientX - box.left - left) / (box.width - left - right);
      this.seek(Math.min(1, Math.max(0, share)) * this.end);
    };
    svg.addEventListener("pointerdown", (event) => {
      svg.setPointerCapture(event.pointerId);
      move(event);
    });
    svg.addEventListener("pointermove", (event) => event.buttons && move(event));
    figure.append(caption, svg);
    this.place.append(figure);
    return { ...panel, svg, values, last };
  }

  draw(width = Math.round(this.place.clientWidth)) {
    if (!width || width === this.width) return;
    this.width = width;
    for (const panel of this.panels) this.drawPanel(panel, width);
    this.update(this.time);
  }

  drawPanel(panel, width) {
    const { left, right, top, bottom, axis } = Replay.EDGES;
    const height = Replay.HEIGHT + (panel.last ? axis - bottom : 0);
    panel.svg.replaceChildren();
    panel.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    panel.svg.setAttribute("height", height);
    const [low, high] = Replay.range(panel);
    const floor = Replay.HEIGHT - bottom;
    panel.x = (t) => left + (t / this.end) * (width - left - right);
    panel.y = (v) => floor - ((v - low) / (high - low)) * (floor - top);
    for (const value of Replay.ticks(low, high, 4)) {
      const y = panel.y(value);
      panel.svg.append(Replay.svg("line", { class: "rule", x1: left, x2: width - right, y1: y, y2: y }));
      panel.svg.append(Replay.svg("text", { class: "tick y", x: left - 6, y: y + 5 }, Replay.tick(value)));
    }
    for (const t of Replay.ticks(0, this.end, Math.max(2, Math.min(10, width / 110)))) {
      const x = panel.x(t);
      panel.svg.append(Replay.svg("line", { class: "rule", x1: x, x2: x, y1: top, y2: floor }));
      if (!panel.last) continue;
      panel.svg.append(Replay.svg("text", { class: "tick x", x, y: floor + 16 }, `${Replay.tick(t)} s`));
    }
    for (const [t, name] of this.events) {
      const mark = Replay.svg("line", { class: "event", x1: panel.x(t), x2: panel.x(t), y1: top, y2: floor });
      mark.append(Replay.svg("title", {}, `${name} at ${t.toFixed(2)} s`));
      panel.svg.append(mark);
    }
    for (const line of [...panel.series].reverse()) {
      const d = Replay.path(line, panel, width);
      panel.svg.append(Replay.svg("path", { class: `line ${line.colour}${line.dash ? " dash" : ""}`, d }));
    }
    panel.cursor = Replay.svg("line", { class: "cursor", y1: top - 4, y2: floor });
    panel.dots = panel.series.map((line) => Replay.svg("circle", { class: `dot ${line.colour}`, r: 3.2 }));
    panel.svg.append(panel.cursor, ...panel.dots);
  }

  update(time) {
    this.time = time;
    for (const panel of this.panels) {
      if (!panel.cursor) continue;
      const x = panel.x(Math.min(time, this.end));
      panel.cursor.setAttribute("x1", x);
      panel.cursor.setAttribute("x2", x);
      panel.series.forEach((line, n) => {
        const value = Replay.valueAt(line, time);
        const known = Number.isFinite(value);
        panel.values[n].textContent = known ? Replay.number(value, panel.digits) : "–";
        panel.dots[n].setAttribute("visibility", known ? "visible" : "hidden");
        if (!known) return;
        panel.dots[n].setAttribute("cx", panel.x(Math.min(time, line.flight.end)));
        panel.dots[n].setAttribute("cy", panel.y(value));
      });
    }
  }
};

Replay.valueAt = (line, time) => {
  if (!line.flight.known(time)) return NaN;
  const [k, share] = line.flight.moment(Math.min(time, line.flight.end));
  const value = line.value(k);
  return share && !line.held ? value + share * (line.value(k + 1) - value) : value;
};

Replay.range = (panel) => {
  let [low, high] = panel.zero ? [0, 0] : [Infinity, -Infinity];
  for (const line of panel.series) {
    for (let k = 0; k < line.flight.rows; k++) {
      const value = line.value(k);
      if (value < low) low = value;
      if (value > high) high = value;
    }
  }
  const margin = Math.max(0.08 * (high - low), 10 ** -panel.digits);
  return [panel.zero ? 0 : low - margin, high + margin];
};

// The line as an SVG path; where there are more rows than pixels, the lowest and highest of every pixel.
Replay.path = (line, panel, width) => {
  const { flight, value } = line;
  let d = "";
  for (let part = 0; part + 1 < flight.parts.length; part++) {
    const [first, stop] = [flight.parts[part], flight.parts[part + 1]];
    const stride = Math.max(1, Math.floor((stop - first) / (2 * width)));
    let pen = false;
    for (let k = first; k < stop; k += stride) {
      let [a, b] = [k, k];
      for (let j = k; j < Math.min(k + stride, stop); j++) {
        if (value(j) < value(a)) a = j;
        if (value(j) > value(b)) b = j;
      }
      for (const row of a === b ? [a] : [Math.min(a, b), Math.max(a, b)]) {
        if (!Number.isFinite(value(row))) {
          pen = false;
          continue;
        }
        const [x, y] = [panel.x(flight.t[row]).toFixed(1), panel.y(value(row)).toFixed(1)];
        if (!pen) d += `M${x} ${y}`;
        else d += line.held ? `H${x}V${y}` : `L${x} ${y}`;
        pen = true;
      }
    }
  }
  return d;
};

Replay.element = (name, attributes = {}, text = null) => {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== null) element.textContent = text;
  return element;
};

Replay.svg = (name, attributes = {}, text = null) => {
  const element = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== null) element.textContent = text;
  return element;
};
