// Adds to viser's page: releases of keys, an on-screen stick, and a point that can be dragged in a triangle.
// Runs once per page. It sends numbers to the server through two text fields of the panel, found by their labels.
(() => {
  if (window.pfnnPage) { // the panel is rebuilt after the connection was lost
    window.pfnnPage();
    return;
  }

  // Viser 1.1.1 ends its page when a skinned mesh goes, as it does whenever the connection is lost: it keeps null in place
  // of the node, and then calls a method of it. For the nodes of the body null means that there is none. To be dropped
  // with the first viser whose page survives the end of its program without it, which tests/viewer/test_page_look.py tries.
  for (const name of BODY_NODES) { // filled in by widgets.py
    const keep = (owner, value) => Object.defineProperty(owner, name, {
      get: () => value,
      set: (next) => { if (next === null) delete owner[name]; else value = next; },
      enumerable: true,
      configurable: true,
    });
    Object.defineProperty(Object.prototype, name, {
      get: () => undefined,
      set(value) { if (value !== null) keep(this, value); },
      enumerable: false,
      configurable: true,
    });
  }

  const DRIVE = "Stick and keys", SHARES = "Shares";
  const KEYS = { KeyW: "w", KeyA: "a", KeyS: "s", KeyD: "d", KeyQ: "q", KeyE: "e" };
  const BEAT = 200; // ms between messages while something is held
  const held = new Set();
  let shift = false, latched = false, stick = null, count = 0, timer = 0, rate = 0;

  const LOW = matchMedia("(max-height: 430.9px)"); // as in framing.py

  const field = (label) => {
    const found = [...document.querySelectorAll("label")].find((element) => element.textContent === label);
    if (!found) return null;
    let box = found;
    while (box && !box.querySelector("input")) box = box.parentElement;
    return box;
  };
  const write = (label, text) => {
    const input = field(label)?.querySelector("input");
    if (!input) return false;
    Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set.call(input, text);
    input.dispatchEvent(new Event("input", { bubbles: true }));
    return true;
  };
  const hide = () => { // the field only transports messages
    const box = field(DRIVE);
    if (box) box.parentElement.style.display = "none";
  };

  // On a phone the controls are a sheet at the bottom (upright) or a small panel (sideways), and show the stick and the
  // list of styles until they are opened. `pfnn-more` is what a closed one hides.
  const KEEP = "[data-stick], [data-start], [data-learning]";
  const kept = (element) => element.matches(KEEP) || element.querySelector(KEEP) ||
    [...element.querySelectorAll("label")].some((label) => label.textContent === "Style" || label.textContent === "Run");
  const mark = (container) => {
    for (const item of container?.children ?? []) {
      const folder = item.hasAttribute("data-with-border") ? item.children[1] : null;
      const keep = Boolean(kept(item));
      item.classList.toggle("pfnn-more", !keep);
      if (keep && folder) mark(folder.firstElementChild?.firstElementChild);
    }
  };
  const arrange = () => {
    const names = document.querySelector("[data-run]")?.dataset.run;
    document.title = names ? `pfnn_jax \u2014 ${names}` : "pfnn_jax";
    const pad = document.querySelector("[data-stick]"), first = pad ?? document.querySelector("[data-start]");
    if (!first) return;
    let sheet = first;
    while (sheet && sheet.style.position !== "fixed" && !sheet.dataset.floatingWindow) sheet = sheet.parentElement;
    sheet?.classList.add("pfnn-controls");
    const fixed = sheet?.style.position === "fixed"; // as viser makes it in a narrow window
    sheet?.classList.toggle("pfnn-sheet", fixed);
    sheet?.classList.toggle("pfnn-compact", fixed || LOW.matches);
    document.querySelector("[data-readout]")?.closest("[data-floating-window]")?.classList.add("pfnn-readouts");
    mark(pad?.closest("[data-with-border]")?.parentElement);
  };
  const openSheet = () => {
    const sheet = document.querySelector(".pfnn-controls");
    const open = sheet?.classList.toggle("pfnn-open");
    for (const grip of document.querySelectorAll("[data-sheet]")) grip.setAttribute("aria-expanded", String(open));
  };

  const drags = new Map(); // by pointer (every finger is one): { key } or { move }
  const down = (key) => held.has(key) || [...drags.values()].some((drag) => drag.key === key);
  const input = () => {
    const on = (key) => (down(key) ? 1 : 0);
    const ahead = stick ? stick[0] : on("w") - on("s"), left = stick ? stick[1] : on("a") - on("d");
    return [ahead.toFixed(3), left.toFixed(3), on("q") - on("e"), shift || latched ? 1 : 0].map(Number).join(" ");
  };
  const show = () => {
    for (const element of document.querySelectorAll("[data-drive]")) {
      const key = element.dataset.drive;
      element.classList.toggle("on", key === "shift" ? shift || latched : down(key));
    }
    const knob = document.querySelector("[data-knob]");
    if (knob) {
      const [ahead, left] = input().split(" ").map(Number), size = Math.max(1, Math.hypot(ahead, left));
      knob.style.transform = `translate(${(-left / size) * 26}px, ${(-ahead / size) * 26}px)`;
    }
  };
  // Viser sends at once, but of what follows within 50 ms it keeps the last message only, of whatever control. The messages
  // of this script are therefore sent one by one, and not until what a person has pressed, chosen or typed has been sent.
  const GAP = 60, ALONE = 100; // ms after a message of this script, and after something that a person did
  const waiting = new Map(); // label -> text; the one that has waited longest is first
  let free = -Infinity, pump = 0, sent = -Infinity;
  const act = () => { free = performance.now() + ALONE; };
  const flush = () => {
    clearTimeout(pump);
    if (free <= performance.now()) {
      const [label, text] = waiting.entries().next().value;
      waiting.delete(label);
      write(label, text);
      free = performance.now() + GAP;
    }
    if (waiting.size) pump = setTimeout(flush, free - performance.now());
  };
  const post = (label, text) => { // of a label that waits already, the later text is sent in its turn
    waiting.set(label, text);
    flush();
  };
  const send = () => {
    sent = performance.now();
    post(DRIVE, `${++count} ${input()} ${rate.toFixed(1)} ${document.hidden ? 0 : 1}`);
  };
  const onAct = (event) => { // the camera has a way of its own, and a text field is also written by this script
    if (event.target.tagName !== "CANVAS" && (event.type !== "input" || event.isTrusted)) act();
  };
  for (const type of ["click", "input", "focusout"]) document.addEventListener(type, onAct, true);
  const report = (more = 1) => { // at once, then while anything is held; a release twice, as a slider's messages can replace it
    send();
    show();
    clearTimeout(timer);
    const idle = /^0 0 0 /.test(input());
    if (!idle) timer = setTimeout(report, BEAT);
    else if (more > 0) timer = setTimeout(() => report(more - 1), BEAT);
  };

  let frames = 0, since = performance.now(); // pictures per second that this browser manages
  const beat = (now) => {
    frames += 1;
    if (now - since >= 1000) {
      rate = (1000 * frames) / (now - since);
      frames = 0;
      since = now;
      send();
    }
    requestAnimationFrame(beat);
  };
  requestAnimationFrame(beat);

  const typing = (element) => {
    if (!element) return false;
    if (element.getAttribute("role") === "combobox") // a list takes keys only while it is open
      return element.getAttribute("aria-expanded") === "true";
    return element.isContentEditable || element.tagName === "TEXTAREA" ||
      (element.tagName === "INPUT" && !/^(checkbox|radio|range|button|file)$/.test(element.type));
  };
  const leave = () => typing(document.activeElement) && document.activeElement.blur();
  const onKey = (event) => {
    if (!event.isTrusted) return;
    if (event.key === "Shift") {
      shift = event.type === "keydown";
      if (held.size || drags.size) report();
      else show();
      return;
    }
    if (event.key === "Escape" || event.key === "Enter") setTimeout(leave, 0);
    if (event.code === "KeyK" && (event.ctrlKey || event.metaKey)) { // viser's list of commands
      event.stopImmediatePropagation();
      event.preventDefault();
    }
    const key = KEYS[event.code];
    if (!key) {
      if (event.target.getAttribute?.("role") === "slider") act();
      return;
    }
    if (event.type === "keyup") {
      if (held.delete(key)) report();
      return;
    }
    if (typing(event.target) || event.ctrlKey || event.metaKey || event.altKey || !field(DRIVE)) return;
    event.stopImmediatePropagation(); // otherwise it would move the camera
    event.preventDefault();
    shift = event.shiftKey;
    if (!held.has(key)) {
      held.add(key);
      report();
    }
  };
  const releaseAll = () => {
    const any = held.size || drags.size;
    held.clear();
    drags.clear();
    stick = null;
    shift = false;
    if (any) report();
    else show();
  };
  window.addEventListener("keydown", onKey, true);
  window.addEventListener("keyup", onKey, true);
  window.addEventListener("blur", releaseAll);
  document.addEventListener("visibilitychange", () => { // nothing is computed for a hidden tab
    if (document.hidden) releaseAll();
    frames = rate = 0;
    since = performance.now();
    send();
  });

  // Pointers: buttons, the stick, the triangle.
  const toStick = (event) => {
    const pad = document.querySelector("[data-stick]");
    if (!pad) return;
    const box = pad.getBoundingClientRect(), r = box.width / 2;
    const x = (event.clientX - box.left - r) / (0.72 * r), y = (event.clientY - box.top - r) / (0.72 * r);
    const length = Math.hypot(x, y), scale = length < 0.15 ? 0 : 1 / Math.max(1, length);
    stick = [-y * scale, -x * scale];
    report();
  };
  const toTriangle = (event) => {
    const svg = document.querySelector("[data-triangle]");
    if (!svg) return;
    const box = svg.getBoundingClientRect(), view = svg.viewBox.baseVal;
    const x = ((event.clientX - box.left) / box.width) * view.width, y = ((event.clientY - box.top) / box.height) * view.height;
    const [a, b, c] = svg.dataset.triangle.split(" ").map((corner) => corner.split(",").map(Number));
    const area = (b[1] - c[1]) * (a[0] - c[0]) + (c[0] - b[0]) * (a[1] - c[1]);
    let u = ((b[1] - c[1]) * (x - c[0]) + (c[0] - b[0]) * (y - c[1])) / area;
    let v = ((c[1] - a[1]) * (x - c[0]) + (a[0] - c[0]) * (y - c[1])) / area;
    let shares = [u, v, 1 - u - v].map((share) => Math.max(0, share));
    const sum = shares[0] + shares[1] + shares[2];
    shares = shares.map((share) => share / sum);
    const percent = shares.map((share) => Math.round(100 * share));
    percent[percent.indexOf(Math.max(...percent))] += 100 - percent[0] - percent[1] - percent[2];
    const point = [0, 1].map((i) => shares[0] * a[i] + shares[1] * b[i] + shares[2] * c[i]);
    const dot = svg.querySelector("[data-dot]");
    dot.setAttribute("cx", point[0]);
    dot.setAttribute("cy", point[1]);
    post(SHARES, percent.join(" "));
  };
  const start = (event) => {
    if (event.button !== 0) return;
    const target = event.target.closest?.("[data-drive], [data-stick], [data-triangle], [data-sheet]");
    if (!target) {
      if (event.target.tagName === "CANVAS") document.activeElement?.blur();
      else act(); // on a slider, which changes at once
      return;
    }
    event.preventDefault();
    document.activeElement?.blur();
    if ("sheet" in target.dataset) {
      openSheet();
    } else if ("drive" in target.dataset) {
      const key = target.dataset.drive;
      if (key === "shift") latched = !latched;
      else drags.set(event.pointerId, { key });
      report();
    } else {
      const move = "stick" in target.dataset ? toStick : toTriangle;
      if ([...drags].some(([id, drag]) => id !== event.pointerId && drag.move === move)) return; // another finger holds it
      drags.set(event.pointerId, { move });
      move(event);
    }
  };
  const end = (event) => {
    const drag = drags.get(event.pointerId);
    if (!drag) return;
    drags.delete(event.pointerId);
    if (drag.move === toStick) stick = null;
    if (drag.move !== toTriangle) report();
  };
  document.addEventListener("pointerdown", start, true);
  const move = (event) => {
    if (event.buttons === 0) end(event); // released outside the page
    else drags.get(event.pointerId)?.move?.(event);
  };
  document.addEventListener("pointermove", move, true);
  document.addEventListener("pointerup", end, true);
  document.addEventListener("pointercancel", end, true);
  // A list, checkbox or slider that was used would keep the focus, and with it the keys.
  document.addEventListener("click", (event) => {
    if (event.target.closest?.("[role=option], input[type=checkbox], button, [role=slider]"))
      setTimeout(leave, 0);
  });

  // When the connection is lost, viser only dims its panels and ignores clicks. This shows a message.
  const PALE = '[style*="opacity: 0.5"][style*="pointer-events: none"]';
  const ended = document.createElement("div");
  ended.className = "pfnn-ended";
  ended.hidden = true;
  ended.setAttribute("role", "alert");
  ended.textContent = "No connection: the program that serves this page has ended or cannot be reached. " +
    "The page reconnects as soon as the program runs again at this address.";
  document.body.append(ended);
  let pale = 0;
  setInterval(() => { // twice in a row, because short interruptions recover by themselves
    pale = document.querySelector("[data-stick]")?.closest(PALE) ? pale + 1 : 0;
    ended.hidden = pale < 2;
    arrange();
    if (performance.now() - sent > 1500) send(); // also where the browser draws rarely
  }, 700);
  LOW.addEventListener("change", () => arrange());

  const settle = () => {
    hide();
    arrange();
  };
  window.pfnnPage = () => {
    settle();
    for (const delay of [50, 150, 300]) setTimeout(settle, delay);
  };
  window.pfnnPage();
  new MutationObserver(settle).observe(document.body, { childList: true, subtree: false });
})();
