"use strict";
// The colours of all pages: those of the system, or the reader's choice.
const root = document.documentElement;

const remembered = {
  get() { try { return localStorage.getItem("theme"); } catch { return null; } },
  set(theme) { try { localStorage.setItem("theme", theme); } catch { /* file:// may forbid it */ } },
};
const stored = remembered.get();
if (stored === "light" || stored === "dark") root.dataset.theme = stored;

function addToggle() {
  const dark = () => (root.dataset.theme || (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light")) === "dark";
  const button = document.createElement("button");
  button.type = "button";
  button.id = "theme";
  const say = () => { button.textContent = dark() ? "Light" : "Dark"; button.setAttribute("aria-label", `Switch to ${dark() ? "light" : "dark"} colours`); };
  button.addEventListener("click", () => { root.dataset.theme = dark() ? "light" : "dark"; remembered.set(root.dataset.theme); say(); });
  say();
  document.querySelector("body > header").append(button);
}

document.addEventListener("DOMContentLoaded", addToggle);
