// What is wider than its place scrolls: by the keyboard, too, and its edge fades as long as more follows.
// A panorama begins in its middle, which looks forward.
const WIDE = "article pre, div.math, .table-wrapper, .picture"
const begun = new WeakSet()

function mark(box) {
  const hidden = box.scrollWidth - box.clientWidth
  if (hidden > 1) box.tabIndex = 0
  else box.removeAttribute("tabindex")
  if (hidden > 1 && !begun.has(box)) {
    begun.add(box)
    if (box.closest(".stills") || /panorama/i.test(box.querySelector("img")?.alt)) box.scrollLeft = hidden / 2
  }
  box.classList.toggle("more", hidden - box.scrollLeft > 1)
  box.classList.toggle("less", hidden > 1 && box.scrollLeft > 1)
}

const sizes = new ResizeObserver(entries => entries.forEach(entry => mark(entry.target)))

document.addEventListener("DOMContentLoaded", async () => {
  const boxes = document.querySelectorAll(WIDE)
  for (const box of boxes) {
    sizes.observe(box)
    box.addEventListener("scroll", () => mark(box), { passive: true })
  }
  await window.MathJax?.startup?.promise // formulas take their room late
  boxes.forEach(mark)
})

// What the theme leaves unsaid to a screen reader: what its two side bars and its page of results are.
document.addEventListener("DOMContentLoaded", () => {
  for (const [bar, name] of [["sidebar", "All pages"], ["toc", "On this page"]])
    document.querySelector(`.${bar}-drawer`)?.setAttribute("aria-label", name)
  const results = document.getElementById("search-results")
  if (!results) return
  results.insertAdjacentHTML("beforebegin", "<h1>Search</h1>")
  // A page that the search has found by a heading or a term is found by its text, too: once is enough.
  new MutationObserver(() => {
    const seen = new Set()
    for (const item of results.querySelectorAll("li:not(.kind-object)")) {
      const page = item.querySelector("a").pathname
      item.hidden = seen.has(page)
      seen.add(page)
    }
  }).observe(results, { childList: true, subtree: true })
})
