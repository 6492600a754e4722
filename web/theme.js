// A file of its own: the ground's content security policy lets no inline script run.
// The theme before the first paint, so that nothing flashes.
try {
  var kept = localStorage.getItem("plumbline.theme");
  var dark = kept ? kept === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  document.documentElement.dataset.theme = dark ? "dark" : "light";
} catch (e) {}
