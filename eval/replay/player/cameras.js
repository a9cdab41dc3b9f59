// Where one looks from: around everything, with a vehicle, from the side, from above, at the pad.
"use strict";

// The nearest position from which a camera of given axes sees all points: every point bounds it by planes.
Replay.framing = (points, right, up, forward, halfWidth, halfHeight) => {
  const local = points.map((p) => [p.dot(right), p.dot(up), p.dot(forward)]);
  const place = [0, 0];
  const depth = [];
  [halfWidth, halfHeight].forEach((half, k) => {
    const far = Math.max(...local.map((p) => p[k] - half * p[2]));
    const near = Math.max(...local.map((p) => -p[k] - half * p[2]));
    place[k] = (far - near) / 2;
    depth.push(-(far + near) / (2 * half));
  });
  const position = new THREE.Vector3();
  position.addScaledVector(right, place[0]).addScaledVector(up, place[1]);
  return position.addScaledVector(forward, Math.min(...depth));
};

Replay.FILLED = 0.9; // share of the picture that what matters may fill

Replay.Cameras = class {
  constructor(canvas, flights, scenes) {
    Object.assign(this, { canvas, flights, scenes });
    this.wide = new THREE.PerspectiveCamera(34, 1, 0.02, 90);
    this.flat = new THREE.OrthographicCamera(-1, 1, 1, -1, 0.1, 60);
    for (const camera of [this.wide, this.flat]) camera.up.set(0, 0, 1);
    this.free = new THREE.OrbitControls(this.wide, canvas);
    this.pan = new THREE.OrbitControls(this.flat, canvas);
    this.pan.enableRotate = false;
    this.pan.screenSpacePanning = true;
    // A finger or a button that cannot turn the picture moves it.
    this.pan.mouseButtons.LEFT = 2;
    this.pan.touches.ONE = 1;
    for (const controls of [this.free, this.pan]) {
      controls.minDistance = 0.15;
      controls.maxDistance = 20;
      controls.minZoom = 0.3;
      controls.maxZoom = 30;
      controls.maxPolarAngle = Math.PI;
    }
    this.aspect = 1;
    this.name = "orbit";
  }

  // Corners of what has to be in the picture: the ways of the shown flights, goal and platform.
  subject(shown, selected) {
    const low = [Infinity, Infinity, Infinity];
    const high = [-Infinity, -Infinity, -Infinity];
    const take = (p, margin) => p.forEach((value, k) => {
      low[k] = Math.min(low[k], value - margin);
      high[k] = Math.max(high[k], value + margin);
    });
    this.flights.forEach((flight, n) => {
      if (!shown[n]) return;
      for (let k = 0; k < flight.rows; k += 4) take([...flight.position.subarray(3 * k, 3 * k + 3)], 0.16);
    });
    const { scene, goal } = this.flights[selected];
    if (goal) take(goal.position, 0.2);
    const platform = this.scenes[scene].platform;
    if (platform) {
      const [x, , z] = platform.position;
      const [length, depth] = platform.half;
      take([x - length, -depth, z - 0.75], 0);
      take([x + length, depth, z + 0.25], 0);
    } else if (!Number.isFinite(low[0])) take([0, 0, 1], 1);
    const corners = [];
    for (const x of [low[0], high[0]]) for (const y of [low[1], high[1]]) for (const z of [low[2], high[2]]) {
      corners.push(new THREE.Vector3(x, y, z));
    }
    return corners;
  }

  use(name, shown, selected) {
    this.name = name;
    const points = this.subject(shown, selected);
    const middle = points.reduce((sum, p) => sum.add(p), new THREE.Vector3()).divideScalar(8);
    if (name === "side") this.level(points, middle, new THREE.Vector3(0, -1, 0), new THREE.Vector3(0, 0, 1));
    else if (name === "top") this.level(points, middle, new THREE.Vector3(0, 0, 1), new THREE.Vector3(0, 1, 0));
    else {
      const along = { orbit: [0.42, 0.9, -0.26], follow: [0.5, 0.85, -0.3], pad: [0.36, 0.9, -0.34] }[name];
      const forward = new THREE.Vector3(...along).normalize();
      let target = middle;
      let distance = null;
      if (name === "follow") {
        target = this.where(selected);
        distance = this.near;
      } else if (name === "pad") {
        const platform = this.scenes[this.flights[selected].scene].platform;
        const goal = this.flights[selected].goal;
        const place = platform ? platform.position : goal ? goal.position : this.where(selected, Infinity).toArray();
        target = new THREE.Vector3(...place).add(new THREE.Vector3(0, 0, 0.06));
        distance = 1.25 * this.near;
      }
      if (distance === null) {
        const right = forward.clone().cross(new THREE.Vector3(0, 0, 1)).normalize();
        const up = right.clone().cross(forward);
        const half = Math.tan((this.wide.fov * Math.PI) / 360) * Replay.FILLED;
        const position = Replay.framing(points, right, up, forward, half * this.aspect, half);
        this.wide.position.copy(position);
        target = position.clone().addScaledVector(forward, middle.clone().sub(position).dot(forward));
      } else this.wide.position.copy(target).addScaledVector(forward, -distance);
      this.free.target.copy(target);
      this.free.update();
    }
    this.free.enabled = !this.isFlat;
    this.pan.enabled = this.isFlat;
  }

  // m from a vehicle or the pad; narrow pictures stand back.
  get near() {
    return 1.25 / Math.min(1, this.aspect);
  }

  get isFlat() {
    return this.name === "side" || this.name === "top";
  }

  get camera() {
    return this.isFlat ? this.flat : this.wide;
  }

  level(points, middle, back, up) {
    const right = up.clone().cross(back);
    const extent = (axis) => {
      const along = points.map((p) => p.dot(axis));
      return (Math.max(...along) - Math.min(...along)) / 2 / Replay.FILLED;
    };
    this.span = Math.max(extent(up), extent(right) / this.aspect);
    this.flat.up.copy(up);
    this.flat.zoom = 1;
    this.flat.position.copy(middle).addScaledVector(back, 20);
    this.flat.lookAt(middle);
    this.pan.target.copy(middle);
    this.shape();
    this.pan.update();
  }

  where(selected, time = this.time || 0) {
    const flight = this.flights[selected];
    const at = Math.min(time, flight.end);
    return new THREE.Vector3(...[0, 1, 2].map((c) => flight.at(flight.position, 3, c, at)));
  }

  // Go along with the vehicle; the view that a hand has chosen stays.
  follow(time, selected) {
    this.time = time;
    if (this.name !== "follow") return;
    const target = this.where(selected);
    this.wide.position.add(target.clone().sub(this.free.target));
    this.free.target.copy(target);
    this.free.update();
  }

  shape() {
    const span = this.span || 1;
    Object.assign(this.flat, { left: -span * this.aspect, right: span * this.aspect, top: span, bottom: -span });
    this.flat.updateProjectionMatrix();
  }

  resize(aspect) {
    this.aspect = aspect;
    this.wide.aspect = aspect;
    this.wide.updateProjectionMatrix();
    this.shape();
  }
};
