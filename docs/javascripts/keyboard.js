// the theme wraps tables when a page has loaded; the wrappers scroll on narrow screens, so the keyboard must reach them
addEventListener("load", () => requestAnimationFrame(() => {
  for (const wrapper of document.querySelectorAll(".md-typeset__scrollwrap")) wrapper.tabIndex = 0;
}));
