"use strict";
// A job: the ground changes while the motion plays, a section shows it from the side, and every
// cycle can be looked at.
(() => {
  const get = (id) => document.getElementById(id);
  const { viewer, element, number, bytes, heard } = backhoe, THREE = MeshCat.THREE;
  const job = heard.job, plan = heard.plan, end = plan.time[plan.time.length - 1];
  const COLOURS = { approach: "#5b87b5", cut: "#a4632f", swing: "#2f8f83", dump: "#d29a1e", return: "#8fa9c4", wait: "#b9bfc5" };

  const shorts = (text) => new Int16Array(bytes(text).buffer);
  const changes = job.changes.map((one) => ({ time: one.time, columns: new Uint32Array(bytes(one.columns).buffer),
    heights: shorts(one.heights), loose: bytes(one.loose) }));

  // ---- the ground ------------------------------------------------------------------

  const [rows, columns] = job.ground.shape, [x0, y0] = job.ground.low, cell = job.ground.cell;
  const first = shorts(job.ground.heights), firstLoose = bytes(job.ground.loose);
  const heights = new Float32Array(rows * columns);
  const position = new Float32Array(3 * rows * columns), colours = new Float32Array(3 * rows * columns);
  const [untouched, soil, spoil] = job.ground.colours;

  // Loose soil, from 0 for none to 255 where it hides what is below: dug soil where the ground is lower than at first.
  function put(index, millimetres, loose, changed) {
    heights[index] = position[3 * index + 2] = millimetres / 1000;
    const below = changed && (millimetres < first[index] || loose === 0) ? soil : untouched, part = loose / 255;
    for (let k = 0; k < 3; k++) colours[3 * index + k] = below[k] + part * (spoil[k] - below[k]);
  }

  let applied = 0, shown = -1;
  function reset() {
    for (let k = 0; k < first.length; k++) put(k, first[k], firstLoose[k], false);
    applied = 0;
  }

  function changeUntil(time) {
    if (time < shown) reset();
    const before = applied;
    while (applied < changes.length && changes[applied].time <= time + 1e-6) {
      const { columns: where, heights: high, loose } = changes[applied++];
      for (let k = 0; k < where.length; k++) put(where[k], high[k], loose[k], true);
    }
    if (time < shown || applied !== before || shown < 0) {
      geometry.attributes.position.needsUpdate = geometry.attributes.color.needsUpdate = true;
      viewer.set_dirty();
    }
    shown = time;
  }

  for (let row = 0; row < rows; row++) {
    for (let column = 0; column < columns; column++) {
      const k = 3 * (row * columns + column);
      position[k] = x0 + cell * column;
      position[k + 1] = y0 + cell * row;
    }
  }
  const index = new Uint32Array(6 * (rows - 1) * (columns - 1));
  for (let row = 0, k = 0; row < rows - 1; row++) {
    for (let column = 0; column < columns - 1; column++) {
      const a = row * columns + column, b = a + 1, c = a + columns, d = c + 1;
      index.set([a, b, d, a, d, c], k);
      k += 6;
    }
  }
  reset();
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(position, 3));
  geometry.setAttribute("color", new THREE.BufferAttribute(colours, 3));
  geometry.setIndex(new THREE.BufferAttribute(index, 1));
  const surface = new THREE.Mesh(geometry, new THREE.MeshPhongMaterial({ vertexColors: true, flatShading: true, shininess: 4,
    side: THREE.DoubleSide }));
  surface.receiveShadow = true;
  surface.frustumCulled = false;
  viewer.scene_tree.find(job.ground.node).set_object(surface);

  // What lies in the ground shows through it, paler than where it is open.
  for (const name of job.buried) {
    const solids = [];
    viewer.scene_tree.find(["site", name]).object.traverse((one) => { if (one.isMesh) solids.push(one); });
    for (const solid of solids) {
      const through = new THREE.Mesh(solid.geometry, solid.material.clone());
      Object.assign(through.material, { depthFunc: THREE.GreaterDepth, depthWrite: false, transparent: true, opacity: 0.16,
        side: THREE.FrontSide });
      solid.add(through);
    }
  }

  // ---- cycles ------------------------------------------------------------------------

  get("panel").insertBefore(get("cycles-section"), get("margins").parentElement);
  get("panel").insertBefore(get("undug-section"), get("margins").parentElement);
  get("panel").insertBefore(get("compared-section"), get("switches").parentElement);
  get("track").prepend(get("legs"));
  get("stage").append(get("now"));
  const kinds = [...new Set(job.parts.map((part) => part.name))];
  for (const name of kinds) {
    const key = element("span"), mark = element("i");
    mark.style.background = COLOURS[name];
    key.append(mark, document.createTextNode(name === "wait" ? "wait for a truck" : name));
    get("legend").append(key);
  }
  const firstOf = (cycle) => job.parts.find((part) => part.cycle === cycle.number);
  const body = get("cycles").tBodies[0];
  for (const cycle of job.cycles) {
    const row = body.insertRow();
    cycle.row = row;
    if (!cycle.verified) { row.className = "bad"; row.title = "not verified"; }
    else row.title = cycle.truck ? `${cycle.step}, truck ${cycle.truck}` : cycle.step;
    const cells = [cycle.number, `${number(cycle.duration, 1)} s`, `${number(cycle.work / 1000, 0)} kJ`,
      `${number(cycle.bank, 2)} m³`, `${number(100 * cycle.filled, 0)} %`, `${number(100 * cycle.depth, 0)} cm`];
    for (const text of cells) row.append(element("td", "", String(text)));
    row.addEventListener("click", () => { backhoe.seek(firstOf(cycle).begin); });
  }
  for (const part of job.parts) {
    const block = element("button");
    block.type = "button";
    block.tabIndex = -1;
    block.style.left = `${100 * part.begin / end}%`;
    block.style.width = `${100 * (part.end - part.begin) / end}%`;
    block.style.background = COLOURS[part.name];
    block.title = `cycle ${part.cycle}: ${part.name}, ${number(part.end - part.begin, 1)} s`;
    block.addEventListener("click", (event) => {
      const box = block.getBoundingClientRect();
      backhoe.pause();
      backhoe.seek(part.begin + (event.clientX - box.left) / Math.max(box.width, 1) * (part.end - part.begin));
    });
    get("legs").append(block);
  }
  for (const cycle of job.cycles) {
    const begin = firstOf(cycle).begin, mark = element("span", "", String(cycle.number));
    mark.style.left = `${100 * begin / end}%`;
    get("legs").append(mark);
  }
  for (const words of job.undug) get("undug").append(element("li", "", words.replaceAll("m^3", "m³")));
  const patterns = get("compared").tBodies[0];
  for (const one of job.compared) {
    const row = patterns.insertRow();
    if (one.chosen) row.className = "chosen";
    const name = element("td", "", one.name);
    if (!one.finished) name.append(element("span", "hint", " leaves some"));
    row.append(name, element("td", "", `${one.cycles} cycles`),
      element("td", "", `${number(one.duration / 60, 1)} min`), element("td", "", `${number(one.work / 1e6, 2)} MJ`));
  }
  get("legs").hidden = get("now").hidden = get("cycles-section").hidden = job.cycles.length === 0;
  get("undug-section").hidden = job.undug.length === 0;
  get("compared-section").hidden = job.compared.length === 0;

  let present = null;
  function showPart(time) {
    const part = job.parts.find((one) => time < one.end) || job.parts[job.parts.length - 1];
    if (part === undefined || part === present) return;
    present = part;
    const mark = element("i");
    mark.style.background = COLOURS[part.name];
    get("now").replaceChildren(mark, document.createTextNode(`Cycle ${part.cycle} of ${job.cycles.length}: ${part.name}`));
    for (const cycle of job.cycles) cycle.row.classList.toggle("now", cycle.number === part.cycle);
    const row = job.cycles.find((cycle) => cycle.number === part.cycle).row;
    const box = get("cycles-section"), list = row.parentElement;
    if (list.scrollHeight > list.clientHeight && box.clientHeight > 0) row.scrollIntoView({ block: "nearest" });
  }

  // ---- section -----------------------------------------------------------------------

  const BELOW = 36;  // px of the section for the numbers and words below it
  const section = job.section, canvas = get("section"), card = get("section-card");
  const known = (values) => values.filter((value) => value !== null);
  const depths = [...known(section.design), ...section.end, ...section.start,
    ...section.crossings.map((one) => one.z - one.half)];
  const lowest = Math.min(...depths) - 0.25, highest = Math.max(...depths, 0) + 0.7;
  function redrawSection() {
    drawSection(plan.time.length > 1 ? Math.min(backhoe.time / end, 1) * (plan.time.length - 1) : 0);
  }
  get("panel").insertBefore(card, get("facts-section"));  // over the picture it would hide the bucket
  card.hidden = false;
  get("section-fold").addEventListener("click", () => {
    const folded = card.classList.toggle("folded");
    get("section-fold").textContent = folded ? "Show" : "Hide";
    get("section-fold").setAttribute("aria-expanded", String(!folded));
  });

  function drawSection(frame) {
    const width = canvas.clientWidth;
    if (width === 0) return;
    const left = 34, scale = (width - left - 8) / section.length;
    const tall = Math.min(Math.max((highest - lowest) * scale + BELOW, 90), 272), stretch = (tall - BELOW) / (highest - lowest);
    const ratio = devicePixelRatio || 1;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(tall * ratio);
    canvas.style.height = `${tall}px`;
    const pen = canvas.getContext("2d");
    pen.scale(ratio, ratio);
    const px = (station) => left + scale * station, py = (z) => 6 + stretch * (highest - z);
    const at = (k) => px(k * section.length / (section.columns.length - 1));
    const line = (values, style, dash, thick) => {
      pen.beginPath();
      let open = false;
      values.forEach((z, k) => {
        if (z === null) { open = false; return; }
        if (open) pen.lineTo(at(k), py(z)); else pen.moveTo(at(k), py(z));
        open = true;
      });
      pen.setLineDash(dash);
      pen.strokeStyle = style;
      pen.lineWidth = thick;
      pen.stroke();
      pen.setLineDash([]);
    };
    pen.fillStyle = "#eaf1f7";
    pen.fillRect(left, 6, width - left - 8, tall - BELOW);
    pen.save();
    pen.beginPath();
    pen.rect(left, 6, width - left - 8, tall - BELOW);
    pen.clip();
    const now = section.columns.map((k) => heights[k]);
    pen.beginPath();
    pen.moveTo(at(0), py(lowest - 1));
    now.forEach((z, k) => pen.lineTo(at(k), py(z)));
    pen.lineTo(at(now.length - 1), py(lowest - 1));
    pen.fillStyle = "#b59a7a";
    pen.fill();
    line(now, "#5f4a33", [], 1.5);
    line(section.start, "#7d8790", [2, 3], 1);
    line(section.end, "#50483e", [1, 3], 1.6);
    line(section.design, "#1c7f4b", [6, 4], 1.8);
    for (const one of section.crossings) {
      pen.beginPath();
      pen.ellipse(px(one.station), py(one.z), scale * (one.half + one.clearance), stretch * (one.radius + one.clearance), 0, 0, 7);
      pen.strokeStyle = "rgba(200, 110, 0, .75)";
      pen.setLineDash([3, 3]);
      pen.lineWidth = 1;
      pen.stroke();
      pen.setLineDash([]);
      pen.beginPath();
      pen.ellipse(px(one.station), py(one.z), Math.max(scale * one.half, 2), Math.max(stretch * one.radius, 2), 0, 0, 7);
      pen.fillStyle = "#f29e1a";
      pen.fill();
      pen.fillStyle = "#3d3226";
      pen.font = "10px system-ui, sans-serif";
      pen.textAlign = "center";
      pen.textBaseline = "top";
      const under = py(one.z - one.radius - one.clearance) + 2, over = py(one.z + one.radius + one.clearance) - 13;
      pen.fillText(one.name, px(one.station), under + 12 < py(lowest) ? under : over);
    }
    drawBucket(pen, Math.round(frame), px, py);
    pen.restore();
    pen.fillStyle = "#5d6b78";
    pen.font = "10px system-ui, sans-serif";
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    const step = highest - lowest > 2.5 ? 1 : 0.5;
    for (let z = Math.ceil(lowest / step) * step; z <= highest; z += step) pen.fillText(number(z, 1), left - 4, py(z));
    pen.textAlign = "center";
    pen.textBaseline = "top";
    for (let s = Math.ceil(-section.axis); s <= section.length - section.axis; s += 1) pen.fillText(String(s), px(s + section.axis), tall - 27);
    pen.fillText("distance from the swing axis and height [m]", left + 0.5 * (width - left), tall - 14);
  }

  function drawBucket(pen, frame, px, py) {
    const tip = section.tip, near = Math.abs(tip.aside[frame]) < 0.5 * section.width + 0.3;
    if (!near || job.cycles.length === 0) return;
    const s = tip.station[frame], z = tip.z[frame], pitch = tip.pitch[frame], c = Math.cos(pitch), d = Math.sin(pitch);
    pen.beginPath();
    for (const [u, w] of section.bucket) pen.lineTo(px(s + section.towards * (u * c - w * d)), py(z + u * d + w * c));
    pen.closePath();
    pen.fillStyle = "rgba(233, 173, 37, .8)";
    pen.fill();
    pen.strokeStyle = "#7a5a0c";
    pen.lineWidth = 1;
    pen.stroke();
  }

  get("section-title").textContent = "Section";
  new ResizeObserver(() => drawSection(lastFrame)).observe(card);

  // ---- time --------------------------------------------------------------------------

  const speed = get("speed");
  for (const times of [8, 16, 32]) {
    const choice = element("option", "", `${times}×`);
    choice.value = times;
    speed.append(choice);
  }
  speed.value = end > 60 ? "8" : "2";
  let lastFrame = 0;
  function follow(time, frame) {
    lastFrame = frame;
    changeUntil(time);
    showPart(time);
    drawSection(frame);
  }
  addEventListener("backhoe-time", (event) => follow(event.detail.time, event.detail.frame));
  redrawSection();
  follow(backhoe.time, 0);
})();
