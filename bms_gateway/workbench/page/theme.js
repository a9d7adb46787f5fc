"use strict";
// Light or dark before anything is drawn, so that nothing flashes.
document.documentElement.dataset.theme =
  localStorage.getItem("theme") || (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
