// The flights as the page was given them: columns unpacked, moments looked up. No drawing.
"use strict";

const Replay = {};

Replay.bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));

Replay.floats = (text) => new Float32Array(Replay.bytes(text).buffer);

// One flight: `t` (T), `position`, `attitude`, `velocity` (T x 3), `commands` (T x 4), `contacts`.
Replay.Flight = class {
  constructor(packed, number) {
    Object.assign(this, packed);
    this.number = number;
    for (const name of ["t", "position", "attitude", "velocity", "commands"]) this[name] = Replay.floats(packed[name]);
    this.parts = [0, ...packed.anew, this.rows]; // rows at which a part begins, and the end
    this.begins = new Set(packed.anew);
    this.end = this.t[this.rows - 1];
    if (packed.contacts) {
      const counts = Replay.bytes(packed.contacts.counts);
      this.first = new Uint32Array(this.rows + 1);
      for (let k = 0; k < this.rows; k++) this.first[k + 1] = this.first[k] + counts[k];
      this.points = Replay.floats(packed.contacts.points);
      this.forces = Replay.floats(packed.contacts.forces);
    }
  }

  // The last row that is not later than `time`.
  row(time) {
    let low = 0;
    let high = this.rows;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (this.t[middle] <= time) low = middle;
      else high = middle;
    }
    return low;
  }

  // Row and share of the way to the next one.
  moment(time) {
    const k = this.row(time);
    if (k + 1 >= this.rows) return [k, 0];
    const step = this.t[k + 1] - this.t[k];
    const joined = step > 0 && !this.begins.has(k + 1);
    return [k, joined ? Math.min(1, Math.max(0, (time - this.t[k]) / step)) : 0];
  }

  // Is there a motion at `time`: a simulation of a log has holes, and may begin late and end early.
  known(time) {
    if (this.kind !== "simulated") return true;
    const k = this.row(time);
    const ends = this.begins.has(k + 1) || k + 1 === this.rows;
    return time >= this.t[0] - 1e-3 && !(ends && time > this.t[k] + 1e-3);
  }

  // Entry `c` of a column of `width` numbers at `time`, between rows on a straight line.
  at(column, width, c, time) {
    const [k, share] = this.moment(time);
    const value = column[k * width + c];
    return share ? value + share * (column[(k + 1) * width + c] - value) : value;
  }

  // Sum of the contact forces [N] in a row, and the single ones as [point, force] pairs.
  net(k) {
    let [x, y, z] = [0, 0, 0];
    for (let c = this.first[k]; c < this.first[k + 1]; c++) {
      x += this.forces[3 * c];
      y += this.forces[3 * c + 1];
      z += this.forces[3 * c + 2];
    }
    return Math.hypot(x, y, z);
  }

  contactsAt(time) {
    const k = this.row(time + 1e-6);
    const found = [];
    for (let c = this.first[k]; c < this.first[k + 1]; c++) {
      found.push([this.points.subarray(3 * c, 3 * c + 3), this.forces.subarray(3 * c, 3 * c + 3)]);
    }
    return found;
  }

  get strongest() {
    let most = 0;
    for (let c = 0; this.forces && c < this.forces.length; c += 3) {
      most = Math.max(most, Math.hypot(this.forces[c], this.forces[c + 1], this.forces[c + 2]));
    }
    return most;
  }
};

// Quaternion [x, y, z, w] of Rz(yaw) Rx(roll) Ry(pitch); an angle that was not logged counts as zero.
Replay.quaternion = (roll, pitch, yaw) => {
  const [cr, sr] = [Math.cos(roll / 2 || 0), Math.sin(roll / 2 || 0)];
  const [cp, sp] = [Math.cos(pitch / 2 || 0), Math.sin(pitch / 2 || 0)];
  const [cy, sy] = [Math.cos(yaw / 2 || 0), Math.sin(yaw / 2 || 0)];
  const [w, x, y, z] = [cr * cp, sr * cp, cr * sp, sr * sp];
  return [cy * x - sy * y, cy * y + sy * x, cy * z + sy * w, cy * w - sy * z];
};

// A number in words: a proper minus, and none before zero.
Replay.number = (value, digits) => {
  const text = value.toFixed(digits);
  return /^-[0.]*$/.test(text) ? text.slice(1) : text.replace("-", "−");
};

Replay.degrees = (angle) => (angle * 180) / Math.PI;
