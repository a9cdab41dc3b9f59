// The three-dimensional picture: world, vehicles, trails, copies, goals and forces. Axes are MuJoCo's, z up.
"use strict";

Replay.LOOKS = {
  light: {
    sky: 0xe9f0f9, wall: ["#eef3fb", "#cdd8e8"], floor: ["#dfe3ea", "#cfd6e0"], hemisphere: [0xffffff, 0xaab4c4, 2.0],
    sun: 1.9, frame: 0x5b79b0, ghost: 0.32, future: 0.35,
  },
  dark: {
    sky: 0x10161d, wall: ["#18212b", "#2b3947"], floor: ["#222c37", "#1b242d"], hemisphere: [0xdbe6f5, 0x2a323c, 1.25],
    sun: 1.5, frame: 0x5f83bd, ghost: 0.42, future: 0.5,
  },
};
Replay.GOAL = 0x1f9e55;
Replay.FORCE = 0xd7301f;

Replay.Stage = class {
  constructor(canvas, flights, scenes, colours) {
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, preserveDrawingBuffer: true });
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = THREE.PCFShadowMap;
    this.flights = flights;
    this.scenes = scenes;
    this.root = new THREE.Scene();
    this.light = new THREE.HemisphereLight(0xffffff, 0x888888, 2);
    this.light.position.set(0, 0, 1);
    this.sun = new THREE.DirectionalLight(0xffffff, 1.8);
    this.sun.castShadow = true;
    this.sun.shadow.mapSize.set(2048, 2048);
    this.sun.shadow.bias = -0.0005;
    this.sun.shadow.normalBias = 0.004;
    const side = this.sun.shadow.camera;
    Object.assign(side, { left: -3.9, right: 3.9, top: 3.4, bottom: -3.4, near: 0.5, far: 14 });
    this.sun.position.set(-2.2, -3.0, 6.5);
    this.root.add(this.light, this.sun, this.sun.target);
    this.sun.target.position.set(0.2, 0.4, 0.3);
    this.worlds = scenes.map((scene) => this.world(scene));
    const models = scenes.map((scene) => Replay.vehicle(scene));
    this.strongest = Math.max(0, ...flights.map((flight) => flight.strongest));
    this.actors = flights.map((flight, k) => new Replay.Actor(flight, scenes[flight.scene], models[flight.scene], colours[k]));
    for (const actor of this.actors) this.root.add(actor.group);
    this.large = true;
    this.select(0);
  }

  world(scene) {
    const group = new THREE.Group();
    for (const geom of scene.world) {
      const mesh = Replay.mesh(geom);
      mesh.name = geom.name;
      mesh.receiveShadow = true;
      mesh.castShadow = !["floor", "back_wall"].includes(geom.name) && !geom.name.startsWith("frame_");
      if (geom.name.startsWith("frame_")) mesh.material = new THREE.MeshBasicMaterial({ color: 0x5b79b0 });
      group.add(mesh);
    }
    this.root.add(group);
    return group;
  }

  look(name) {
    const look = Replay.LOOKS[name];
    this.root.background = new THREE.Color(look.sky);
    this.haze = new THREE.Fog(look.sky, 10, 26);
    this.light.color.set(look.hemisphere[0]);
    this.light.groundColor.set(look.hemisphere[1]);
    this.light.intensity = look.hemisphere[2];
    this.sun.intensity = look.sun;
    const floor = Replay.texture((pen) => {
      pen.fillStyle = look.floor[0];
      pen.fillRect(0, 0, 256, 256);
      pen.fillStyle = look.floor[1];
      pen.fillRect(0, 0, 128, 128);
      pen.fillRect(128, 128, 128, 128);
    }, 2);
    const wall = Replay.texture((pen) => {
      pen.fillStyle = look.wall[0];
      pen.fillRect(0, 0, 256, 256);
      pen.fillStyle = look.wall[1];
      pen.fillRect(0, 0, 256, 3);
      pen.fillRect(0, 0, 3, 256);
    }, 1);
    for (const world of this.worlds) {
      for (const mesh of world.children) {
        if (mesh.name === "floor") mesh.material = new THREE.MeshStandardMaterial({ map: floor, roughness: 1 });
        if (mesh.name === "back_wall") mesh.material = new THREE.MeshBasicMaterial({ map: wall });
        if (mesh.name.startsWith("frame_")) mesh.material.color.set(look.frame);
      }
    }
    for (const actor of this.actors) actor.look(look);
  }

  // Make a flight the one whose platform and goal are shown.
  select(number) {
    this.selected = number;
    this.worlds.forEach((world, k) => (world.visible = k === this.flights[number].scene));
  }

  // options: which flights are `shown`, and trail, copies, forces, goal, large.
  update(time, options) {
    this.actors.forEach((actor, k) => {
      actor.goal.visible = options.goal && k === this.selected;
      actor.group.visible = options.shown[k];
      if (options.shown[k]) actor.update(time, options, this.strongest);
    });
  }

  resize(width, height, ratio) {
    this.renderer.setPixelRatio(ratio);
    this.renderer.setSize(width, height, false);
  }

  render(camera) {
    this.root.fog = camera.isPerspectiveCamera ? this.haze : null; // parallel views have no distance
    this.renderer.render(this.root, camera);
  }
};

Replay.texture = (draw, metres) => {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 256;
  draw(canvas.getContext("2d"));
  const texture = new THREE.CanvasTexture(canvas);
  texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
  texture.colorSpace = THREE.SRGBColorSpace;
  texture.anisotropy = 8;
  texture.userData.metres = metres; // that one tile covers
  return texture;
};

// --- shapes of the MuJoCo model ---------------------------------------------------------------------------------

Replay.ENDLESS = 60; // m, half side of a plane without a size

Replay.geometry = (geom, fine = 24) => {
  const [a, b, c] = geom.size;
  const upright = (geometry) => geometry.rotateX(Math.PI / 2); // three's axis is y, MuJoCo's z
  switch (geom.kind) {
    case "box": return new THREE.BoxGeometry(2 * a, 2 * b, 2 * c);
    case "sphere": return new THREE.SphereGeometry(a, fine, fine / 2);
    case "ellipsoid": return new THREE.SphereGeometry(1, fine, fine / 2).scale(a, b, c);
    case "cylinder": return upright(new THREE.CylinderGeometry(a, a, 2 * b, fine * 2));
    case "capsule": return upright(new THREE.CapsuleGeometry(a, 2 * b, fine / 4, fine));
    case "plane": return Replay.plane(a || Replay.ENDLESS, b || Replay.ENDLESS);
    default: {
      const geometry = new THREE.BufferGeometry();
      const corners = geom.faces.flatMap((v) => geom.vertices.slice(3 * v, 3 * v + 3));
      geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(corners), 3));
      geometry.computeVertexNormals();
      return geometry;
    }
  }
};

// A plane whose texture tiles are metres; its middle is the corner of four tiles.
Replay.plane = (x, y) => {
  const geometry = new THREE.PlaneGeometry(2 * x, 2 * y);
  const place = geometry.attributes.position;
  const uv = geometry.attributes.uv;
  for (let k = 0; k < place.count; k++) uv.setXY(k, place.getX(k), place.getY(k));
  return geometry;
};

Replay.colour = (rgba) => new THREE.Color().setRGB(rgba[0], rgba[1], rgba[2], THREE.SRGBColorSpace);

Replay.pose = (object, geom) => {
  const [w, x, y, z] = geom.quaternion;
  object.position.set(...geom.position);
  object.quaternion.set(x, y, z, w);
  object.updateMatrix();
  return object;
};

Replay.mesh = (geom) => {
  const material = new THREE.MeshStandardMaterial({ color: Replay.colour(geom.colour), roughness: 0.85 });
  return Replay.pose(new THREE.Mesh(Replay.geometry(geom, 40), material), geom);
};

// Geoms as one geometry with a colour at every corner, about `centre`.
Replay.merged = (geoms, centre = [0, 0, 0]) => {
  const parts = geoms.map((geom) => {
    const part = Replay.geometry(geom, 12).toNonIndexed();
    part.applyMatrix4(Replay.pose(new THREE.Mesh(), geom).matrix);
    part.translate(-centre[0], -centre[1], -centre[2]);
    part.deleteAttribute("uv");
    const colour = Replay.colour(geom.colour);
    const count = part.attributes.position.count;
    const colours = new Float32Array(3 * count);
    for (let k = 0; k < count; k++) colour.toArray(colours, 3 * k);
    part.setAttribute("color", new THREE.BufferAttribute(colours, 3));
    return part;
  });
  return THREE.mergeGeometries(parts);
};

// The vehicle in few pieces: the body, every rotor about its axis, the discs.
Replay.vehicle = (scene) => {
  const turning = /^(blade|hub)_((front|rear)_(left|right))/;
  const rotors = new Map();
  const body = [];
  const discs = [];
  for (const geom of scene.vehicle) {
    const found = turning.exec(geom.name);
    if (geom.colour[3] < 1) discs.push(geom);
    else if (found) rotors.set(found[2], [...(rotors.get(found[2]) || []), geom]);
    else body.push(geom);
  }
  return {
    body: Replay.merged(body),
    discs: Replay.merged(discs),
    opacity: discs[0].colour[3],
    rotors: [...rotors.values()].map((geoms) => {
      const hub = geoms.find((geom) => geom.name.startsWith("hub_")).position;
      return { hub, sense: Math.sign(hub[0] * hub[1]), geometry: Replay.merged(geoms, hub) };
    }),
    feet: scene.feet,
    low: scene.low,
    scale: scene.scale,
  };
};

// --- one flight -------------------------------------------------------------------------------------------------

Replay.TURNS = 9; // rad/s that rotors seem to turn at, slow enough to be seen
Replay.TRAIL = 0.005; // m, radius
Replay.LONGEST = 0.26; // m, arrow of the strongest force beside a vehicle drawn large; others by the square root
Replay.NEAR = 0.008; // m from a foot's centre within which a contact is that foot's

Replay.Actor = class {
  constructor(flight, scene, model, colour) {
    Object.assign(this, { flight, model, colour });
    this.group = new THREE.Group();
    const simulated = flight.kind === "simulated";
    this.copy = this.build(simulated ? { tint: colour, opacity: 0.8 } : {});
    this.group.add(this.copy.outer);
    this.ghosts = flight.copies.map((row) => {
      const ghost = this.build({ tint: colour, opacity: 0.3 });
      this.place(ghost.outer, row, 0);
      this.group.add(ghost.outer);
      return { ...ghost, row };
    });
    // Through the middle of the vehicle as it is drawn: in its true size, and larger on the same foot tips.
    this.tubes = [0, model.low * (1 - model.scale)].map((lift) => Replay.tube(flight, colour, lift));
    for (const tube of this.tubes) this.group.add(tube.mesh, tube.line);
    this.arrows = new THREE.Group();
    this.group.add(this.arrows);
    this.goal = this.goalMark(flight.goal);
    this.group.add(this.goal);
    this.feet = flight.contacts ? this.footLights() : [];
  }

  build({ tint, opacity = 1 }) {
    const outer = new THREE.Group();
    const inner = new THREE.Group();
    outer.add(inner);
    const solid = opacity === 1;
    const plain = { roughness: 0.55, vertexColors: true };
    const tinted = { roughness: 0.7, color: tint, transparent: true, opacity, emissive: tint, emissiveIntensity: 0.25 };
    const material = new THREE.MeshStandardMaterial(tint === undefined ? plain : tinted);
    const body = new THREE.Mesh(this.model.body, material);
    const clear = { color: tint ?? 0x8ca6c2, transparent: true, opacity: opacity * this.model.opacity, depthWrite: false };
    const discs = new THREE.Mesh(this.model.discs, new THREE.MeshBasicMaterial(clear));
    const rotors = this.model.rotors.map(({ hub, geometry, sense }) => {
      const rotor = new THREE.Mesh(geometry, material);
      rotor.position.set(...hub);
      rotor.castShadow = solid;
      rotor.userData.sense = sense;
      return rotor;
    });
    body.castShadow = solid || opacity > 0.5;
    inner.add(body, discs, ...rotors);
    return { outer, inner, rotors, material };
  }

  place(object, k, share) {
    const { position: p, attitude: a } = this.flight;
    const next = share ? k + 1 : k;
    const mix = (column, c) => column[3 * k + c] + share * (column[3 * next + c] - column[3 * k + c]);
    object.position.set(mix(p, 0), mix(p, 1), mix(p, 2));
    object.quaternion.set(...Replay.quaternion(mix(a, 0), mix(a, 1), mix(a, 2)));
  }

  // The vehicle grows from its foot tips, which stay where the real ones are.
  grow(copy, scale) {
    copy.inner.scale.setScalar(scale);
    copy.inner.position.z = this.model.low * (1 - scale);
  }

  footLights() {
    return this.model.feet.map((foot) => {
      const light = new THREE.Mesh(
        new THREE.SphereGeometry(1.15 * foot.size[0], 16, 8),
        new THREE.MeshBasicMaterial({ color: Replay.FORCE }),
      );
      light.position.set(...foot.position);
      light.visible = false;
      this.copy.inner.add(light);
      return light;
    });
  }

  goalMark(goal) {
    const group = new THREE.Group();
    if (!goal) return group;
    const ghost = this.build({ tint: Replay.GOAL, opacity: 0.34 });
    ghost.outer.position.set(...goal.position);
    ghost.outer.quaternion.set(...Replay.quaternion(...goal.attitude));
    group.add(ghost.outer);
    this.goalGhost = ghost;
    if (goal.size) {
      const [x, y, z] = goal.position;
      const d = goal.size;
      const corners = [[-d, -d], [d, -d], [d, d], [-d, d]].flatMap(([a, b]) => [x + a, y, z + b]);
      const square = new THREE.BufferGeometry();
      square.setAttribute("position", new THREE.BufferAttribute(new Float32Array(corners), 3));
      square.setIndex([0, 1, 2, 0, 2, 3]);
      const edge = new THREE.BufferGeometry();
      edge.setAttribute("position", square.attributes.position);
      const clear = { color: Replay.GOAL, transparent: true, opacity: 0.1, side: THREE.DoubleSide, depthWrite: false };
      group.add(new THREE.Mesh(square, new THREE.MeshBasicMaterial(clear)));
      group.add(new THREE.LineLoop(edge, new THREE.LineBasicMaterial({ color: Replay.GOAL })));
    }
    return group;
  }

  look(look) {
    for (const tube of this.tubes) tube.line.material.opacity = look.future;
    for (const ghost of this.ghosts) ghost.material.opacity = look.ghost;
  }

  update(time, options, strongest) {
    const scale = options.large ? this.model.scale : 1;
    const [k, share] = this.flight.moment(time);
    this.place(this.copy.outer, k, share);
    this.copy.outer.visible = this.flight.known(time);
    for (const copy of [this.copy, ...this.ghosts, ...(this.goalGhost ? [this.goalGhost] : [])]) this.grow(copy, scale);
    const motors = this.flight.commands[4 * k] > 0;
    for (const rotor of this.copy.rotors) {
      if (motors && !options.still) rotor.rotation.z = rotor.userData.sense * Replay.TURNS * time;
    }
    for (const ghost of this.ghosts) ghost.outer.visible = options.copies;
    this.tubes.forEach((tube, n) => tube.show(k, options.trail && this.copy.outer.visible && options.large === (n === 1)));
    this.force(time, options, scale, strongest);
  }

  force(time, options, scale, strongest) {
    this.arrows.clear();
    for (const light of this.feet) light.visible = false;
    if (!this.flight.contacts) return;
    const anchor = new THREE.Vector3(0, 0, this.model.low).applyQuaternion(this.copy.outer.quaternion);
    anchor.add(this.copy.outer.position);
    const inverse = this.copy.outer.quaternion.clone().invert();
    for (const [point, force] of this.flight.contactsAt(time)) {
      const at = new THREE.Vector3(...point);
      const own = at.clone().sub(this.copy.outer.position).applyQuaternion(inverse);
      this.feet.forEach((light) => (light.visible ||= light.position.distanceTo(own) < Replay.NEAR));
      if (!options.forces) continue;
      const size = Math.hypot(...force);
      const length = (scale / this.model.scale) * Replay.LONGEST * Math.sqrt(size / strongest);
      const from = at.sub(anchor).multiplyScalar(scale).add(anchor);
      this.arrows.add(Replay.arrow(from, new THREE.Vector3(...force).divideScalar(size), length, scale * 0.0022));
    }
  }
};

Replay.arrow = (from, direction, length, radius) => {
  const material = new THREE.MeshBasicMaterial({ color: Replay.FORCE, depthTest: false, transparent: true });
  const head = Math.min(0.45 * length, 5 * radius);
  const shaft = new THREE.Mesh(new THREE.CylinderGeometry(radius, radius, length - head, 12), material);
  shaft.position.y = (length - head) / 2;
  const tip = new THREE.Mesh(new THREE.ConeGeometry(2.4 * radius, head, 16), material);
  tip.position.y = length - head / 2;
  const arrow = new THREE.Group();
  arrow.add(shaft, tip);
  arrow.position.copy(from);
  arrow.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), direction);
  arrow.renderOrder = shaft.renderOrder = tip.renderOrder = 5;
  return arrow;
};

// The way of a flight: a tube up to now, a thin line for all of it; `lift` [m] along the vehicle's own z.
Replay.tube = (flight, colour, lift) => {
  const rows = [];
  const begins = new Set(flight.parts);
  const turn = new THREE.Quaternion();
  const point = (k) => {
    turn.set(...Replay.quaternion(...flight.attitude.subarray(3 * k, 3 * k + 3)));
    const up = new THREE.Vector3(0, 0, lift).applyQuaternion(turn);
    return up.add(new THREE.Vector3(...flight.position.subarray(3 * k, 3 * k + 3)));
  };
  let last = null;
  for (let k = 0; k < flight.rows; k++) {
    const here = point(k);
    const ends = begins.has(k) || begins.has(k + 1);
    if (!last || ends || here.distanceTo(last) > 0.006) {
      rows.push(k);
      last = here;
    }
  }
  const sides = 6;
  const places = new Float32Array(rows.length * sides * 3);
  const index = [];
  const upTo = []; // corners of triangles up to every point
  rows.forEach((k, n) => {
    const before = point(rows[Math.max(0, n - 1)]);
    const after = point(rows[Math.min(rows.length - 1, n + 1)]);
    const along = after.sub(before);
    if (along.lengthSq() < 1e-12) along.set(1, 0, 0);
    along.normalize();
    const across = new THREE.Vector3(0, 1, 0).cross(along);
    if (across.lengthSq() < 1e-6) across.set(1, 0, 0);
    across.normalize();
    const third = along.clone().cross(across);
    const centre = point(k);
    for (let s = 0; s < sides; s++) {
      const angle = (2 * Math.PI * s) / sides;
      const corner = centre.clone();
      corner.addScaledVector(across, Replay.TRAIL * Math.cos(angle));
      corner.addScaledVector(third, Replay.TRAIL * Math.sin(angle));
      corner.toArray(places, 3 * (n * sides + s));
    }
    if (n && !begins.has(k)) {
      for (let s = 0; s < sides; s++) {
        const [a, b] = [(n - 1) * sides + s, (n - 1) * sides + ((s + 1) % sides)];
        index.push(a, b, a + sides, b, b + sides, a + sides);
      }
    }
    upTo.push(index.length);
  });
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(places, 3));
  geometry.setIndex(index);
  const mesh = new THREE.Mesh(geometry, new THREE.MeshBasicMaterial({ color: colour }));
  const thin = new THREE.BufferGeometry();
  thin.setAttribute("position", new THREE.BufferAttribute(new Float32Array(rows.flatMap((k) => point(k).toArray())), 3));
  const line = new THREE.Line(thin, new THREE.LineBasicMaterial({ color: colour, transparent: true, opacity: 0.35 }));
  mesh.frustumCulled = line.frustumCulled = false;
  const until = (row) => {
    let n = 0;
    while (n + 1 < rows.length && rows[n + 1] <= row) n++;
    return upTo[n];
  };
  const pieces = flight.parts.length > 2; // of those that begin anew, the present one is enough
  const show = (row, visible) => {
    mesh.visible = visible;
    line.visible = visible && !pieces;
    const from = pieces ? until(flight.parts.findLast((first) => first <= row)) : 0;
    geometry.setDrawRange(from, until(row) - from);
  };
  return { mesh, line, show };
};
