"use strict";
// Driving: the hands' wishes go to the session, and its state is shown.
(() => {
  const get = (id) => document.getElementById(id);
  const { viewer, element, number } = backhoe, THREE = MeshCat.THREE, pane = get("meshcat-pane"), stage = get("stage");
  let page = null, state = null, connected = true, toastUntil = 0;

  // ---- where things stand on the page --------------------------------------------
  get("app").append(get("drive"));
  stage.append(get("keys"), get("trouble"), get("toast"));
  get("margins").after(get("taken"));
  get("panel").insertBefore(get("hand-section"), get("facts-section"));
  get("panel").insertBefore(get("site-section"), get("switches").parentElement);
  for (const id of ["drive", "hand-section", "site-section"]) get(id).hidden = false;

  const send = (content) => backhoe.send && backhoe.send(content);
  const driving = () => connected && state !== null && state.driver !== null && state.driver === page;

  function toast(text) {
    get("toast").textContent = text;
    get("toast").hidden = false;
    toastUntil = performance.now() + 4000;
  }

  // ---- hands -----------------------------------------------------------------------

  const held = new Set();
  const ALWAYS = [["Space", "stop"], ["Esc", "let go"]];
  const sticks = (left, right) => [["A / D", "swing"], ["W / S", left], ["\u2191 / \u2193", right],
    ["\u2190 / \u2192", "curl, dump"], ...ALWAYS];
  const KEYS = {
    tip: [["W / S", "out, in"], ["A / D", "left, right"], ["E / Q", "up, down"], ["Z / X", "curl, dump"], ...ALWAYS],
    iso: sticks("stick out, in", "boom down, up"),
    sae: sticks("boom down, up", "stick out, in"),
  };
  const USED = new Set(["KeyW", "KeyS", "KeyA", "KeyD", "KeyE", "KeyQ", "KeyZ", "KeyX",
    "ArrowUp", "ArrowDown", "ArrowLeft", "ArrowRight", "Space"]);
  const both = (plus, minus) => (held.has(plus) ? 1 : 0) - (held.has(minus) ? 1 : 0);
  const free = (value) => Math.abs(value || 0) < 0.12 ? 0 : Math.sign(value) * (Math.abs(value) - 0.12) / 0.88;
  const clamp = (value) => Math.min(Math.max(value, -1), 1);

  const centred = new Set();
  function pad() {
    const found = navigator.getGamepads ? [...navigator.getGamepads()].find((one) => one && one.connected) : null;
    get("gamepad").hidden = !found;
    if (!found) { centred.clear(); return [0, 0, 0, 0]; }
    // a trigger that rests at its end would drive: an axis counts once it was seen at its middle
    return [0, 1, 2, 3].map((axis) => {
      const value = free(found.axes[axis]);
      if (value === 0) centred.add(axis);
      return centred.has(axis) ? value : 0;
    });
  }

  function wish() {
    const [lx, ly, rx, ry] = pad(), mode = get("mode").value, speed = Number(get("drive-speed").value);
    if (mode !== "tip") {
      return { type: "sticks", pattern: mode, speed,
        left: [clamp(both("KeyD", "KeyA") + lx), clamp(both("KeyW", "KeyS") - ly)],
        right: [clamp(both("ArrowRight", "ArrowLeft") + rx), clamp(both("ArrowUp", "ArrowDown") - ry)] };
    }
    const turn = clamp(both("KeyX", "KeyZ") + rx);
    const content = { type: "tip", frame: "arm", velocity: [
      speed * clamp(both("KeyW", "KeyS") - ly), speed * clamp(both("KeyA", "KeyD") - lx),
      speed * clamp(both("KeyE", "KeyQ") - ry)] };
    if (turn !== 0 && state !== null && state.has_pitch) content.pitch_rate = speed * turn;
    return content;
  }

  const something = (content) => content.type === "tip"
    ? content.velocity.some((x) => x !== 0) || content.pitch_rate !== undefined
    : [...content.left, ...content.right].some((x) => x !== 0);

  let moving = false;
  function drive() {
    if (performance.now() > toastUntil) get("toast").hidden = true;
    const content = wish();
    if (!driving() || !document.hasFocus()) return;
    if (something(content)) {
      send(content);
      moving = true;
    } else if (moving) {
      moving = false;
      send({ type: "stop" });
    }
  }

  function rest() { held.clear(); drive(); }

  let asked = false;  // whether this page is letting go
  function letGo() {
    rest();
    if (!driving()) return;
    asked = true;
    send({ type: "release" });
  }

  let drove = false;
  function changeHands() {
    if (driving() === drove) return;
    drove = driving();
    if (!drove && !connected) toast("You let go of the controls: the connection was lost");
    else if (!drove && !asked && state.driver === null && !state.failure) toast("You let go of the controls: this page was silent for too long");
    asked = false;
    stage.classList.toggle("driving", drove);
    moving = false;
    drag = null;
    arm(null);
    // a key or a stick that was already held does not count
    held.clear();
    centred.clear();
  }

  addEventListener("keydown", (event) => {
    if (event.code === "Escape") { arm(null); letGo(); return; }
    if (event.ctrlKey || event.metaKey || event.altKey || !USED.has(event.code) || event.target.matches("select, input[type=text]")) return;
    if (!driving()) {
      if (!event.repeat && event.target === document.body && state !== null && connected) toast("Take the controls first");
      return;
    }
    event.preventDefault();
    if (event.target.matches("button, input")) event.target.blur();
    if (event.code === "Space") { rest(); send({ type: "stop" }); return; }
    if (event.repeat) return;
    held.add(event.code);
    drive();
  });
  addEventListener("keyup", (event) => { held.delete(event.code); });
  function lookAway() {
    if (driving()) toast("You let go of the controls: this window was left");
    letGo();
  }
  addEventListener("blur", lookAway);
  addEventListener("pagehide", lookAway);
  document.addEventListener("visibilitychange", () => { if (document.hidden) lookAway(); });
  setInterval(drive, 40);

  // ---- the bar ---------------------------------------------------------------------

  function showMode() {
    const keys = get("keys");
    keys.replaceChildren();
    for (const [key, does] of KEYS[get("mode").value]) {
      keys.append(element("b", "", key), element("span", "", does));
    }
    const speed = Number(get("drive-speed").value);
    get("drive-speed-value").textContent = get("mode").value === "tip" ? `${speed.toFixed(2)} m/s` : `${Math.round(100 * speed)} %`;
  }
  get("mode").addEventListener("change", () => { get("mode").blur(); rest(); showMode(); });
  get("drive-speed").addEventListener("input", showMode);
  get("take").addEventListener("click", () => {
    get("take").blur();
    if (driving()) letGo(); else send({ type: "take" });
  });
  get("hand-over").addEventListener("click", () => send({ type: "hand_over", to: state.asking[0] }));
  get("record").addEventListener("click", () => send({ type: "record", on: state.recording === "idle" }));
  get("circulate").addEventListener("change", (event) => send({ type: "circulate", on: event.target.checked }));
  showMode();

  // ---- putting, dragging, taking away ------------------------------------------------

  const FORMS = {
    ball: ([x, y, z]) => ({ shape: "sphere", radius: 0.3, position: [x, y, z + 0.3] }),
    post: ([x, y, z]) => ({ shape: "cylinder", radius: 0.12, length: 3.0, position: [x, y, z + 1.5] }),
    block: ([x, y, z]) => ({ shape: "box", size: [0.8, 0.8, 0.8], position: [x, y, z + 0.4] }),
  };
  let armed = null, drag = null;

  function drop(form, at) {
    let number = 1;
    while (state.names.includes(`${form} ${number}`)) number++;
    const name = `${form} ${number}`;
    send({ type: "add", obstacle: { name, ...FORMS[form](at) } });
    return name;
  }

  function arm(form) {
    armed = armed === form ? null : form;
    stage.classList.toggle("dropping", armed !== null);
    for (const button of document.querySelectorAll("[data-drop]")) button.classList.toggle("armed", button.dataset.drop === armed);
  }
  for (const button of document.querySelectorAll("[data-drop]")) {
    button.addEventListener("click", () => { button.blur(); arm(button.dataset.drop); });
  }

  const ray = new THREE.Raycaster(), spot = new THREE.Vector3();
  function aim(event) {
    const box = pane.getBoundingClientRect();
    ray.setFromCamera(new THREE.Vector2(2 * (event.clientX - box.left) / box.width - 1,
      1 - 2 * (event.clientY - box.top) / box.height), viewer.camera);
  }
  const site = (name) => viewer.scene_tree.find(["site", state.nodes[name]]).object;
  const world = (v) => [v.x, -v.z, v.y];  // y is up for the camera

  function hit() {
    if (state === null) return null;
    let best = null;
    for (const name of Object.keys(state.nodes)) {
      const [found] = ray.intersectObject(site(name), true);
      if (found && (best === null || found.distance < best.distance)) best = { name, point: found.point.clone(), distance: found.distance };
    }
    return best;
  }

  function onPlane(point, upright) {
    const normal = upright ? viewer.camera.getWorldDirection(new THREE.Vector3()).setY(0).normalize() : new THREE.Vector3(0, 1, 0);
    return ray.ray.intersectPlane(new THREE.Plane().setFromNormalAndCoplanarPoint(normal, point), spot) ? spot.clone() : null;
  }

  pane.addEventListener("pointerdown", (event) => {
    if (event.button !== 0 || state === null) return;
    aim(event);
    if (armed !== null) {
      event.stopImmediatePropagation();
      const at = onPlane(new THREE.Vector3(0, 0, 0), false);
      const form = armed;
      arm(null);
      if (!driving()) toast("Take the controls first");
      else if (at) drop(form, world(at));
      return;
    }
    const found = driving() ? hit() : null;
    if (found === null) return;
    event.stopImmediatePropagation();
    pane.setPointerCapture(event.pointerId);
    drag = { ...found, shift: state.shifts[found.name], sent: 0 };
  }, true);
  pane.addEventListener("pointermove", (event) => {
    if (drag === null) {
      if (event.buttons === 0 && driving()) { aim(event); stage.classList.toggle("over-movable", hit() !== null); }
      return;
    }
    event.stopImmediatePropagation();
    if (performance.now() - drag.sent < 33) return;
    aim(event);
    const at = onPlane(drag.point, event.shiftKey);
    if (at === null) return;
    const delta = world(at.sub(drag.point)).map((x, k) => event.shiftKey === (k === 2) ? x : 0);
    drag.sent = performance.now();
    send({ type: "move", name: drag.name, to: drag.shift.map((x, k) => x + delta[k]) });
  }, true);
  const undrag = () => { drag = null; };
  pane.addEventListener("pointerup", undrag, true);
  pane.addEventListener("pointercancel", undrag, true);

  function dressRows() {
    const rows = document.querySelectorAll("#margins .margin");
    backhoe.problem.obstacles.forEach((obstacle, k) => {
      const may = driving() && state.movable.includes(obstacle.name), row = rows[k];
      if (!row || row.classList.contains("removable") === may) return;
      row.classList.toggle("removable", may);
      if (!may) { row.querySelector(".remove").remove(); return; }
      const button = element("button", "remove", "✕");
      button.title = `Take ${obstacle.name} away`;
      button.addEventListener("click", () => send({ type: "remove", name: obstacle.name }));
      row.insertBefore(button, row.querySelector(".bar"));
    });
  }

  let listed = "";
  function listTaken() {
    const key = JSON.stringify([driving(), state.taken]);
    if (key === listed) return;
    listed = key;
    const list = get("taken");
    list.hidden = state.taken.length === 0;
    list.replaceChildren();
    for (const name of state.taken) {
      const row = element("div"), text = element("span", "", `${name}, taken away`), button = element("button", "", "Put back");
      text.title = text.textContent;
      button.disabled = !driving();
      button.addEventListener("click", () => send({ type: "put_back", name }));
      row.append(text, button);
      list.append(row);
    }
  }

  // ---- messages from the session --------------------------------------------------------

  function showState(content) {
    state = content;
    changeHands();
    const { kind, word, more } = content.caption;
    get("status").className = kind;
    get("status-word").textContent = word;
    get("status-more").textContent = more;
    get("status").title = [word, more].filter(Boolean).join(", ");
    get("force-value").textContent = `${content.force.toFixed(0)} N`;
    get("force-fill").style.transform = `scaleX(${Math.min(content.force / content.largest_force, 1)})`;
    get("pace-value").textContent = `${Math.round(100 * content.pace)} %`;
    get("pace-fill").style.transform = `scaleX(${content.pace})`;
    const [x, y, z] = content.tip;
    get("tip-line").textContent = `Tip ${number(x, 2)}, ${number(y, 2)}, ${number(z, 2)} m at ${content.speed.toFixed(2)} m/s`;
    const zones = get("zones");
    zones.replaceChildren();
    for (const [name, level] of Object.entries(content.zones)) {
      zones.append(element("span", level, `${name}: ${level}`));
    }
    if (backhoe.problem !== null) {
      for (const obstacle of backhoe.problem.obstacles) {
        const anchor = content.anchors[obstacle.name];
        if (anchor) obstacle.anchor = anchor;
        obstacle.absent = content.absent.includes(obstacle.name);
        if (obstacle.label) obstacle.label.hidden = obstacle.name in content.anchors === false;
      }
      dressRows();
    }
    listTaken();
    const mine = driving(), take = get("take");
    take.textContent = mine ? "Let go" : content.driver === null ? "Take the controls" : `Ask page ${content.driver}`;
    take.className = mine ? "driving" : "";
    get("hand-over").hidden = !mine || content.asking.length === 0;
    get("hand-over").textContent = `Hand over to page ${content.asking[0]}`;
    const record = get("record"), idleRecord = content.recording === "idle";
    record.className = idleRecord ? "" : "on";
    record.disabled = !mine || content.recording === "ending";
    get("record-word").textContent = { idle: "Record", arming: "Waiting for rest", on: `Stop, ${content.recorded.toFixed(1)} s`,
      ending: "Coming to rest" }[content.recording];
    get("circulate").checked = content.circulate;
    get("circulate").disabled = !mine;
    for (const button of document.querySelectorAll("#drops button")) button.disabled = !mine;
  }

  const CONTROLS = "#drive button, #drive select, #drive input, #drops button";
  function showConnection(open) {
    connected = open;
    for (const control of document.querySelectorAll(CONTROLS)) control.disabled = !open;
    if (open || state === null) return;  // the state that follows says which of them may be used
    arm(null);
    changeHands();
    dressRows();
    listTaken();
    get("status").className = "rest";
    get("status-word").textContent = "Not connected";
    get("status-more").textContent = "";
  }

  function showRecorded(content) {
    const out = content.left_out || [];
    get("recorded").textContent = content.writing ? "Writing the recording…" : content.error ? content.error
      : `${content.file.split("/").pop()}: ${content.seconds.toFixed(1)} s, ${content.verdict}`
        + (content.zones ? `, ${content.zones} zone visit${content.zones > 1 ? "s" : ""}` : "")
        + (content.instead ? `, in ${content.file}: ${content.instead}` : "")
        + (out.length === 1 ? `; ${out[0]}` : out.length ? `; ${out.length} changes of the site are left out` : "");
    get("recorded").title = content.file ? [get("recorded").textContent, content.file, ...out].join("\n") : "";
  }

  function showTrouble(text) {
    get("trouble").textContent = text[0].toUpperCase() + text.slice(1);
    get("trouble").hidden = false;
  }

  addEventListener("backhoe", ({ detail: content }) => {
    if (content.type === "you") page = content.page;
    else if (content.type === "connection") showConnection(content.open);
    else if (content.type === "teleop") showState(content);
    else if (content.type === "recorded") showRecorded(content);
    else if (content.type === "trouble") showTrouble(content.text);
    else if (content.type === "answer") {
      backhoe.teleop.answers = (backhoe.teleop.answers + 1) % 1e9;
      const wish = ["tip", "sticks", "stop"].includes(content.to);  // sent before the page knew that it no longer drives
      if (!content.ok && (driving() || !wish)) toast(content.error);
    }
  });

  backhoe.teleop = { drop, get state() { return state; }, get page() { return page; }, get driving() { return driving(); }, answers: 0 };
})();
