// the keyboard must reach what scrolls: code, and tables, which the theme wraps when a page has loaded
const reach = () => requestAnimationFrame(() => {
  for (const part of document.querySelectorAll(".md-typeset__scrollwrap, .md-typeset pre > code"))
    part.tabIndex = part.scrollWidth > part.clientWidth ? 0 : -1;
});
addEventListener("load", reach);
addEventListener("resize", reach);
