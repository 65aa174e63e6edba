// Sends what is dropped anywhere on the page, keeps the cards as the server has them, and submits the forms.
(() => {
  "use strict";
  const PERIOD = 500; // ms; the list is asked for this often
  const [files, list, sending, news, problem] = ["files", "list", "sending", "news", "problem"].map((id) => document.getElementById(id));
  const largest = Number(files.dataset.largest);

  // --- sending: one file after the other, with its share
  let queue = Promise.resolve();

  function send(file, refused = "") {
    const card = document.createElement("article");
    card.className = "card";
    card.innerHTML = "<p><strong></strong> <span></span></p><progress max='1' value='0'></progress>";
    card.querySelector("strong").textContent = file.name;
    sending.append(card);
    const say = (text) => { card.querySelector("span").textContent = text; };
    const fail = (text) => {
      say(text);
      card.querySelector("progress").remove();
      const button = Object.assign(document.createElement("button"), { textContent: "Dismiss", onclick: () => card.remove() });
      card.append(button);
      news.textContent = `${file.name}: ${text}`;
    };
    if (refused || file.size > largest) return fail(refused || `larger than ${largest >> 20} MiB`);
    say("waits to be sent");
    queue = queue.then(() => new Promise((done) => {
      const request = new XMLHttpRequest();
      request.open("POST", "/logs");
      request.setRequestHeader("X-Name", encodeURIComponent(file.name));
      request.upload.onprogress = ({ loaded, total }) => {
        card.querySelector("progress").value = loaded / total;
        say(`sending, ${Math.round((100 * loaded) / total)} %`);
      };
      request.onload = () => (request.status === 200 ? card.remove() : fail(reason(request.responseText)));
      request.onerror = () => fail("could not be sent: the file cannot be read, or the server has ended");
      request.onloadend = () => { done(); refresh(); };
      request.send(file);
    }));
  }

  function reason(text) {
    try {
      const { detail } = JSON.parse(text);
      return typeof detail === "string" ? detail : detail.map((each) => `${each.loc.at(-1)}: ${each.msg}`).join("; ");
    } catch {
      return text || "the server did not say why";
    }
  }

  const carriesFiles = (event) => event.dataTransfer?.types.includes("Files");
  addEventListener("dragover", (event) => {
    if (!carriesFiles(event)) return;
    event.preventDefault();
    document.body.classList.add("over");
  });
  addEventListener("dragleave", (event) => {
    if (!event.relatedTarget) document.body.classList.remove("over"); // left the window
  });
  addEventListener("drop", (event) => {
    document.body.classList.remove("over");
    if (!carriesFiles(event)) return;
    event.preventDefault();
    for (const item of [...event.dataTransfer.items].filter((each) => each.kind === "file")) {
      const isFolder = item.webkitGetAsEntry?.()?.isDirectory;
      send(item.getAsFile(), isFolder ? "a folder; expected a file, such as a ZIP of it" : "");
    }
  });
  document.getElementById("choose").addEventListener("click", () => files.click());
  files.addEventListener("change", () => {
    [...files.files].forEach((file) => send(file));
    files.value = ""; // the same file can be chosen again
  });

  // --- the list: a card is replaced when the server has another one
  const known = new Map(); // id -> HTML
  let tag = "";

  async function refresh() {
    try {
      const answer = await fetch("/list", { cache: "no-store", headers: { "If-None-Match": tag } });
      problem.textContent = answer.status === 401 ? await answer.text() : ""; // another start has another token
      if (answer.status !== 200) return;
      tag = answer.headers.get("ETag");
      show(await answer.text());
    } catch {
      problem.textContent = "The server has ended. Start quadftc serve again.";
    }
  }

  function show(html) {
    const fresh = Object.assign(document.createElement("template"), { innerHTML: html }).content;
    const cards = [...fresh.children];
    const ids = new Set(cards.map((card) => card.id));
    for (const card of [...list.children]) if (!ids.has(card.id)) card.remove();
    for (const id of [...known.keys()]) if (!ids.has(id)) known.delete(id);
    let place = list.firstElementChild;
    for (const card of cards) {
      const [old, text] = [document.getElementById(card.id), card.outerHTML];
      const isSame = known.get(card.id) === text;
      if (!old) list.insertBefore(card, place);
      else {
        place = old.nextElementSibling;
        if (isSame) continue;
        const hadFocus = old.contains(document.activeElement);
        old.replaceWith(card);
        if (hadFocus) card.focus();
      }
      known.set(card.id, text);
      news.textContent = card.dataset.news;
    }
  }

  // --- forms
  addEventListener("submit", async (event) => {
    event.preventDefault();
    const form = event.target;
    const answer = await fetch(form.action, {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify(Object.fromEntries(new FormData(form, event.submitter))),
    });
    const said = form.querySelector(".problem");
    if (said) said.textContent = answer.ok ? "" : reason(await answer.text());
    refresh();
  });
  addEventListener("change", async ({ target }) => {
    if (target.dataset.fills && target.files[0]) target.form.elements[target.dataset.fills].value = await target.files[0].text();
  });

  (async () => {
    for (;;) {
      await refresh();
      await new Promise((done) => setTimeout(done, PERIOD));
    }
  })();
})();
