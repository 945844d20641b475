"use strict";
// The page around meshcat's viewer. `recording` is the page's own content; it is null
// where drawing commands and numbers come through a socket.
function show(recording) {
  const get = (id) => document.getElementById(id);
  const stage = get("stage"), pane = get("meshcat-pane");
  const viewer = new MeshCat.Viewer(pane);
  const THREE = MeshCat.THREE;
  let problem = null, plan = null, view = null;
  let time = 0, playing = false, holding = 0, last = null, movedByHand = false, live = false, resume = null;
  const shown = { clearance: false, "critical points": true, "task/trace": true, ground: true, names: true, shadows: true };

  // meshcat fills the window; here it has a part of it
  const resize = viewer.set_3d_pane_size.bind(viewer);
  viewer.set_3d_pane_size = () => { resize(pane.clientWidth, pane.clientHeight); if (!movedByHand) fit(); };
  new ResizeObserver(() => { viewer.set_3d_pane_size(); drawHeat(); nameLegs(); }).observe(pane);
  pane.addEventListener("pointerdown", () => { movedByHand = true; });
  pane.addEventListener("wheel", () => { movedByHand = true; }, { passive: true });

  function fit() {
    if (resume !== null && resume.eye !== null) return;
    if (view === null || pane.clientHeight === 0) return;
    const aspect = pane.clientWidth / pane.clientHeight, table = view.distances;
    let k = 1;
    while (k < table.length - 1 && table[k][0] < aspect) k++;
    const [a0, d0] = table[k - 1], [a1, d1] = table[k];
    const part = Math.min(Math.max((aspect - a0) / (a1 - a0), 0), 1);
    const distance = d0 + part * (d1 - d0);
    const [tx, ty, tz] = view.target, [x, y, z] = view.direction.map((c, i) => view.target[i] + c * distance);
    viewer.controls.target.set(tx, tz, -ty);  // y is up for the camera
    viewer.set_property(["Cameras", "default", "rotated", "<object>"], "position", [x, z, -y]);
    viewer.set_dirty();
    movedByHand = false;
  }

  // ---- panel -------------------------------------------------------------------

  function element(kind, className, text) {
    const made = document.createElement(kind);
    if (className) made.className = className;
    if (text !== undefined) made.textContent = text;
    return made;
  }

  function colour(margin) {
    const [tight, near, far] = problem.colours;
    const part = Math.min(Math.max(2 * margin / problem.influence, 0), 1);
    const [low, high, mix] = part < 0.5 ? [tight, near, 2 * part] : [near, far, 2 * part - 1];
    return `rgb(${low.map((c, i) => Math.round(255 * (c + mix * (high[i] - c)))).join(",")})`;
  }

  const number = (value, digits) => value.toFixed(digits).replace("-", "\u2212");
  const degrees = (joint, value) => joint.angular ? `${number(value * 180 / Math.PI, 1)}°` : `${number(value, 3)} m`;

  function showProblem(content) {
    problem = content;
    view = content.view;
    plan = null;
    playing = false;
    document.title = content.title;
    get("title").textContent = content.title;
    get("subtitle").textContent = content.subtitle;
    get("verdict").hidden = get("facts-section").hidden = get("bar").hidden = true;
    get("margin-hint").textContent = content.obstacles.length ? "distance beyond the required clearance" : "nothing on the site";
    const margins = get("margins");
    margins.replaceChildren();
    for (const obstacle of content.obstacles) {
      const row = element("div", "margin");
      row.title = `${obstacle.name}: ${obstacle.clearance.toFixed(2)} m to be kept`;
      obstacle.value = element("span", "value far", "\u2013");
      const bar = element("div", "bar");
      obstacle.fill = element("div", "fill");
      bar.append(obstacle.fill);
      row.append(element("span", "name", obstacle.name), obstacle.value, bar);
      margins.append(row);
    }
    const body = get("joints").tBodies[0];
    body.replaceChildren();
    for (const joint of content.joints) {
      const row = body.insertRow();
      row.append(element("td", "name", joint.name));
      const range = element("td", "range"), box = element("div");
      joint.mark = element("i");
      if (joint.lower === null) joint.mark.hidden = true; else range.title =
        `${degrees(joint, joint.lower)} to ${degrees(joint, joint.upper)}`;
      box.append(joint.mark);
      range.append(box);
      joint.value = element("td", "value");
      row.append(range, joint.value);
    }
    const names = get("names");
    names.replaceChildren();
    for (const obstacle of content.obstacles) {
      obstacle.label = null;
      if (!obstacle.anchor) continue;
      obstacle.label = element("span", "", obstacle.name);
      names.append(obstacle.label);
    }
    for (const load of content.loads) {
      load.label = element("span", "load", load.name);
      names.append(load.label);
    }
    for (const goal of content.goals) {
      goal.label = element("span", "goal", goal.name);
      names.append(goal.label);
    }
    const switches = get("switches");
    switches.replaceChildren();
    for (const node of content.hidden) shown[node] = false;
    const kinds = [["clearance", "Clearance shells", "as far around each obstacle as is to be kept"],
      ["critical points", "Nearest points", "a line from the machine to each obstacle where they are nearest: green far, red at the clearance"],
      ["task/trace", "Tip trace", "the way of the tip"], ["ground", "Ground", ""], ["names", "Names", ""], ["shadows", "Shadows", ""]];
    for (const [node, text, more] of kinds) {
      if (node === "ground" && !content.ground) continue;
      const label = element("label"), box = element("input");
      label.title = more;
      box.type = "checkbox";
      box.checked = shown[node];
      box.dataset.node = node;
      box.addEventListener("change", () => { shown[node] = box.checked; applySwitch(node); });
      label.append(box, document.createTextNode(text));
      switches.append(label);
      applySwitch(node);
    }
    const kept = content.kept_axis;  // the colour of the arrow and its cone, null without them
    get("kept").replaceChildren();
    get("kept-section").hidden = get("kept-key").hidden = kept === null;
    get("kept-hint").hidden = true;
    if (kept !== null) {
      get("kept-key").firstElementChild.style.background = `rgb(${kept.map((c) => Math.round(255 * c)).join(",")})`;
    }
    get("warnings").hidden = content.warnings.length === 0;
    get("warnings").textContent = content.warnings.join("\n");
    if (!movedByHand) fit();
  }

  function applySwitch(node) {
    if (node === "names") { get("names").hidden = !shown.names; return; }
    if (node === "shadows") viewer.set_property(["Lights", "sun", "<object>"], "castShadow", shown.shadows);
    else viewer.set_property(node.split("/"), "visible", shown[node]);
    viewer.set_dirty();
  }

  function showPlan(content) {
    plan = content;
    view = content.view;
    const verdict = get("verdict");
    verdict.hidden = false;
    verdict.className = content.verdict;
    get("badge").textContent = content.verdict === "verified" ? "Verified" : `Failed: ${content.reason.replaceAll("_", " ")}`;
    get("message").replaceChildren(...withWholeOptions(content.message));
    const facts = get("facts");
    facts.replaceChildren();
    for (const [label, value, more] of content.facts) {
      facts.append(element("dt", "", label), element("dd", "", value));
      if (more) facts.append(element("dd", "more", more));
    }
    get("facts-section").hidden = false;
    problem.goals.forEach((goal, k) => {
      goal.label.textContent = content.goal === k + 1 ? `${goal.name}, reached` : goal.name;
      goal.label.classList.toggle("reached", content.goal === k + 1);
    });
    showKept(content.kept);
    const end = content.time[content.time.length - 1];
    get("bar").hidden = !(end > 0);
    showLegs(content.legs ?? [], end);
    get("scrubber").max = end;
    for (const node of Object.keys(shown)) applySwitch(node);
    viewer.animator.play();  // makes the tracks follow; from here on our own clock drives them
    viewer.animator.pause();
    fit();
    seek(0);
    drawHeat();
    if (end > 0 && !matchMedia("(prefers-reduced-motion: reduce)").matches) play();
  }

  // ---- legs of a sequence --------------------------------------------------------

  const LEG_COLOURS = ["#4a73a0", "#8f5526", "#26766c", "#83640f", "#5d6797", "#7a4f6f"];  // white is legible on each
  let blocks = [];
  function showLegs(legs, end) {
    blocks = legs.map((leg, k) => {
      const until = k + 1 < legs.length ? legs[k + 1].begins : end, block = element("button");
      block.type = "button";
      block.tabIndex = -1;
      block.style.left = `${100 * leg.begins / end}%`;
      block.style.width = `${100 * (until - leg.begins) / end}%`;
      block.style.background = LEG_COLOURS[k % LEG_COLOURS.length];
      block.title = `${leg.name}: ${number(until - leg.begins, 2)} s${leg.carries ? `, carries ${leg.carries}` : ""}`;
      block.addEventListener("click", (event) => {
        const box = block.getBoundingClientRect();
        pause();
        seek(leg.begins + (event.clientX - box.left) / Math.max(box.width, 1) * (until - leg.begins));
      });
      return block;
    });
    get("leg-strip").replaceChildren(...blocks);
    get("leg-strip").hidden = legs.length === 0;
    nameLegs();
  }

  function nameLegs() {  // in the strip, where the whole name has room
    blocks.forEach((block, k) => {
      block.textContent = plan.legs[k].name;
      if (block.scrollWidth > block.clientWidth) block.textContent = "";
    });
  }

  function enterLeg() {
    const legs = plan.legs ?? [], now = legs.findLastIndex((one) => one.begins <= time + 1e-6);
    get("leg").textContent = now < 0 ? "" : `${now + 1}/${legs.length} ${legs[now].name}`;
    blocks.forEach((block, k) => block.classList.toggle("now", k === now));
    for (const obstacle of problem.obstacles) obstacle.away = now >= 0 && legs[now].away.includes(obstacle.name);
  }

  // a text in which no line ends within an option of the command line, such as --budget
  function withWholeOptions(text) {
    return text.split(/(--[a-z][a-z-]*)/).map((part, k) => k % 2 ? element("span", "option", part) : part);
  }

  function showKept(kept) {
    const rows = get("kept");
    rows.replaceChildren();
    for (const one of kept) {
      const row = element("div", "margin"), bar = element("div", "bar");
      row.title = `allowed ${one.allowed}`;
      one.value = element("span", "value");
      one.fill = element("div", "fill");
      one.most = Math.max(...one.margins, 1e-9);  // null, in legs that do not keep it, counts as 0
      // of a narrow cone so many digits that a tenth of what is left shows, or of what is missing if nothing is left
      const largest = one.most > 1e-9 ? one.most : Math.max(...one.margins.map(Math.abs), 1e-9);
      one.digits = Math.min(Math.max(Math.ceil(1 - Math.log10(largest)), one.angular ? 1 : 2), 6);
      bar.append(one.fill);
      row.append(element("span", "name", `${one.name} ${one.allowed}`), one.value, bar);
      rows.append(row);
    }
    get("kept-section").hidden = kept.length === 0;
    get("kept-hint").hidden = false;
  }

  function showKeptAt(frame) {
    for (const one of plan.kept) {
      const margin = one.margins[frame];
      if (margin === null) {  // in a leg that does not keep it
        one.value.textContent = "\u2013";
        one.value.title = "not to be kept now";
        one.value.className = "value far";
        one.fill.style.transform = "scaleX(0)";
        continue;
      }
      const shown = (value) => number(value, one.digits) + (one.angular ? "°" : " m");
      one.value.textContent = shown(margin);
      one.value.title = `now ${shown(one.values[frame])}`;
      one.value.className = margin < 0 ? "value inside" : "value";
      one.fill.style.transform = `scaleX(${Math.min(Math.max(margin / one.most, 0.015), 1)})`;
      one.fill.style.background = colour(margin < 0 ? 0 : 0.5 * problem.influence * Math.min(margin / one.most, 1));
    }
  }

  function showNumbers(q, margins, links) {
    problem.joints.forEach((joint, k) => {
      joint.value.textContent = degrees(joint, q[k]);
      if (joint.lower !== null) {
        const part = (q[k] - joint.lower) / (joint.upper - joint.lower);
        joint.mark.style.left = `${100 * Math.min(Math.max(part, 0), 1)}%`;
      }
    });
    problem.obstacles.forEach((obstacle, k) => {
      const later = obstacle.absent || time < obstacle.appears_at;
      if (obstacle.away || later) {
        obstacle.value.className = "value far";
        obstacle.value.textContent = obstacle.away ? "not in this leg" : obstacle.absent ? "not there yet" : `from ${obstacle.appears_at.toFixed(1)} s on`;
        obstacle.value.title = "";
        obstacle.fill.style.transform = "scaleX(0)";
        return;
      }
      const margin = margins[k], far = margin === null || margin === undefined || margin > problem.far;
      obstacle.value.className = far ? "value far" : margin < 0 ? "value inside" : "value";
      obstacle.value.textContent = far ? `> ${problem.far.toFixed(1)} m` : `${number(margin, 2)} m`;
      obstacle.value.title = far ? "" : `nearest: ${problem.links[links[k]]}`;
      obstacle.fill.style.transform = `scaleX(${far ? 1 : Math.min(Math.max(margin / problem.far, 0.015), 1)})`;
      obstacle.fill.style.background = far ? "#c9d6cf" : colour(margin);
    });
  }

  // ---- time --------------------------------------------------------------------

  function seek(to) {
    if (plan === null) return;
    const times = plan.time, end = times[times.length - 1];
    time = Math.min(Math.max(to, 0), end);
    viewer.animator.seek(time);
    viewer.animator.display_progress(time);
    const frame = end > 0 ? time / end * (times.length - 1) : 0;  // the frames are even
    const a = Math.floor(frame), b = Math.min(a + 1, times.length - 1), part = frame - a;
    const near = Math.round(frame);
    enterLeg();
    showNumbers(plan.q.map((row) => row[a] + part * (row[b] - row[a])), plan.margins.map((row) => row[near]),
      plan.links.map((row) => row[near]));
    showKeptAt(near);
    get("scrubber").value = time;
    get("clock").textContent = `${time.toFixed(2)} / ${end.toFixed(2)} s`;
    dispatchEvent(new CustomEvent("backhoe-time", { detail: { time, frame } }));
  }

  function play() {
    if (time >= get("scrubber").max - 1e-6) seek(0);
    playing = true;
    holding = 0;
    showButton();
  }

  function pause() { playing = false; showButton(); }

  function showButton() {
    get("play").className = playing ? "playing" : "";
    get("play").setAttribute("aria-label", playing ? "Pause" : "Play");
  }

  // without a graphics card shadows cost more than half of every frame
  let slowFrames = 0;
  function spareShadows(step) {
    slowFrames = step > 0.12 ? slowFrames + 1 : 0;
    if (slowFrames < 8 || !shown.shadows) return;
    shown.shadows = false;
    applySwitch("shadows");
    for (const box of document.querySelectorAll("[data-node=shadows]")) box.checked = false;
  }

  function tick(now) {
    const step = last === null ? 0 : Math.min((now - last) / 1000, 0.5);
    last = now;
    if (playing || live) spareShadows(step);
    if (plan !== null && (viewer.animator.playing || Math.abs(viewer.animator.time - time) > 1e-6)) {
      pause();  // meshcat's own panel has moved it
      seek(viewer.animator.time);
    } else if (playing) {
      const end = plan.time[plan.time.length - 1];
      if (time < end) seek(time + step * Number(get("speed").value));
      else if (!get("loop").checked) pause();
      else if ((holding += step) > 1.2) { holding = 0; seek(0); }
    }
    placeNames();
    requestAnimationFrame(tick);
  }

  function drawHeat() {
    if (plan === null) return;
    const canvas = get("heat"), width = Math.max(canvas.clientWidth, 1);
    canvas.width = width;
    const context = canvas.getContext("2d"), count = plan.time.length;
    // links side by side keep a fixed gap: of the machine to itself counts how far it comes below its greatest margin
    const rows = plan.margins.map((row, k) => {
      const greatest = Math.max(...row.map((margin) => margin ?? 0));
      const scale = problem.obstacles[k].itself && greatest > 0 ? Math.max(0.5 * problem.influence / greatest, 1) : 1;
      return row.map((margin) => margin === null ? problem.far : scale * margin);
    });
    for (let x = 0; x < width; x++) {
      const frame = Math.round(x / Math.max(width - 1, 1) * (count - 1));
      let least = problem.far;
      for (const row of rows) if (row[frame] < least) least = row[frame];
      context.fillStyle = colour(least);
      context.fillRect(x, 0, 1, canvas.height);
    }
  }

  const spot = new THREE.Vector3();
  function findSpot(one) {  // of a name on the screen; whether what it names is there now
    if (one.node) {  // carried: it moves with the machine, and is small where it is not there
      const held = viewer.scene_tree.find(one.node).object;
      spot.set(...one.anchor).applyMatrix4(held.matrixWorld).project(viewer.camera);
      return held.scale.x > 0.5;
    }
    const [x, y, z] = one.anchor, age = one.velocity ? Math.max(time - one.appears_at, 0) : 0;
    const [vx, vy, vz] = one.velocity || [0, 0, 0];
    spot.set(x + vx * age, z + vz * age, -(y + vy * age)).project(viewer.camera);
    return !one.away && time >= (one.appears_at || 0);
  }

  function placeNames() {
    if (problem === null || !shown.names) return;
    const width = pane.clientWidth, height = pane.clientHeight, taken = [];
    for (const obstacle of [...problem.goals, ...problem.loads, ...problem.obstacles]) {
      if (obstacle.label === null) continue;
      const there = findSpot(obstacle);
      const inside = there && Math.abs(spot.x) < 0.98 && Math.abs(spot.y) < 1 && spot.z < 1;
      obstacle.label.style.visibility = inside ? "visible" : "hidden";
      if (!inside) continue;
      const across = obstacle.label.offsetWidth, tall = obstacle.label.offsetHeight;
      const left = (0.5 + 0.5 * spot.x) * width - across / 2;
      let top = Math.max((0.5 - 0.5 * spot.y) * height - 1.3 * tall, left + across > width - 190 ? 46 : 6);
      for (let k = 0; k < 4; k++) {  // names do not cover each other
        const other = taken.find((t) => left < t[0] + t[2] && t[0] < left + across && top < t[1] + tall && t[1] < top + tall);
        if (other === undefined) break;
        top = other[1] - tall - 1;
      }
      taken.push([left, top, across]);
      obstacle.label.style.transform = `translate(${left}px, ${top}px)`;
    }
  }

  get("play").addEventListener("click", () => playing ? pause() : play());
  get("scrubber").addEventListener("input", (event) => { pause(); seek(Number(event.target.value)); });
  get("fit").addEventListener("click", fit);
  get("tree").addEventListener("click", () => {
    get("tree").setAttribute("aria-pressed", stage.classList.toggle("tree"));
    viewer.gui.open();
  });
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.matches("select, input[type=text]")) return;
    if (event.key === "f" || event.key === "F") fit();
    if (plan === null || event.target.matches("button, input[type=checkbox]")) return;
    if (event.key === " ") { event.preventDefault(); if (playing) pause(); else play(); }
  });

  const heard = {};  // the newest content of every kind, for scripts that come later
  function hear(content) {
    heard[content.type] = content;
    if (content.type === "problem" || content.type === "step") get("notice").hidden = true;
    if (content.type === "problem") showProblem(content);
    else if (content.type === "plan") showPlan(content);
    else if (content.type === "step" && problem !== null) {
      time = content.time;
      live = true;
      showNumbers(content.q, content.margins, content.links);
    }
    dispatchEvent(new CustomEvent("backhoe", { detail: content }));
  }

  function notice(text) {
    get("notice").hidden = false;
    get("notice").textContent = text;
  }

  function draw(bytes) { viewer.handle_command_bytearray(bytes); }

  // ---- the connection ----------------------------------------------------------------

  const ENDED = 1001, SHUT_OUT = 1008;  // codes with which the program closes the connection
  const SOON = [0.3, 0.6, 1, 2], LATER = 5, PATIENCE = 15;  // s to the next attempts, and until the page no longer says "lost"
  const STAGE = ["Lights", "Background", "Cameras", "Grid", "Axes"];  // meshcat's own, which cannot be made anew
  let program = null, lostAt = null, attempts = 0;

  function welcome(identity) {
    if (program !== null && program !== identity) { location.reload(); return; }  // another one, perhaps of another version
    if (program !== null) forgetPicture();
    program = identity;
    lostAt = null;
    attempts = 0;
    get("notice").hidden = true;
    hear({ type: "connection", open: true });
  }

  function forgetPicture() {  // what was taken away in the meantime is not told: all is shown anew
    const { camera, controls } = viewer;
    resume = { time: plan === null ? null : time, playing, eye: movedByHand ? camera.position.clone() : null, target: controls.target.clone() };
    plan = null;
    pause();
    for (const name of Object.keys(viewer.scene_tree.children)) if (!STAGE.includes(name)) viewer.delete_path([name]);
  }

  function resumePicture() {  // where the person was
    if (resume.eye !== null) {
      viewer.controls.target.copy(resume.target);
      viewer.camera.position.copy(resume.eye);
      movedByHand = true;
    }
    if (plan !== null && resume.time !== null) {
      seek(resume.time);
      if (!resume.playing) pause();
    }
    resume = null;
    viewer.set_dirty();
  }

  function tryAgain() {
    lostAt = lostAt ?? performance.now();
    notice(performance.now() - lostAt < 1000 * PATIENCE ? "Connection lost, trying again\u2026"
      : "The program that shows this has ended, or cannot be reached. The picture stays; if it comes back, so does the page.");
    setTimeout(connect, 1000 * (SOON[attempts++] ?? LATER));
  }

  function connect() {
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/socket`);
    socket.binaryType = "arraybuffer";
    const say = (text) => { if (socket.readyState === 1) socket.send(text); };
    window.backhoe.send = (content) => say(JSON.stringify(content));
    let reported = false;
    socket.onmessage = (message) => {
      if (typeof message.data !== "string") { draw(new Uint8Array(message.data)); return; }
      const content = JSON.parse(message.data);
      if (content.type === "program") { welcome(content.id); return; }
      if (content.type !== "delivered") { hear(content); return; }
      if (resume !== null) resumePicture();
      say("shown");
      if (reported) return;
      reported = true;  // the first numbers come after the drawing that they belong to
      requestAnimationFrame(() => requestAnimationFrame(() => say("drawn")));
    };
    socket.onclose = (event) => {
      hear({ type: "connection", open: false });
      if (event.code === ENDED) notice("The program that shows this has ended. The picture stays; it can be turned and played.");
      else if (event.code === SHUT_OUT) notice(`The program has disconnected this page: ${event.reason}. Reload it to connect again.`);
      else tryAgain();
    };
  }

  // a loop takes 4 ms for each megabyte, Uint8Array.from 100 ms (measured)
  function bytes(code) {
    const text = atob(code), made = new Uint8Array(text.length);
    for (let k = 0; k < text.length; k++) made[k] = text.charCodeAt(k);
    return made;
  }

  window.backhoe = { viewer, heard, element, number, bytes, seek, play, pause, fit, hear, get time() { return time; }, get plan() { return plan; },
    get problem() { return problem; } };
  if (recording === null) {
    notice("Waiting for the picture…");
    connect();
  } else {
    for (const code of recording.draw) draw(bytes(code));
    recording.tell.forEach(hear);
  }
  viewer.set_3d_pane_size();
  requestAnimationFrame(tick);
}
