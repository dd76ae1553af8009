// What is wider than its place scrolls: by the keyboard, too, and its edge fades as long as more follows.
const WIDE = "article pre, div.math, .table-wrapper, .picture"

function mark(box) {
  const hidden = box.scrollWidth - box.clientWidth
  if (hidden > 1) box.tabIndex = 0
  else box.removeAttribute("tabindex")
  box.classList.toggle("more", hidden - box.scrollLeft > 1)
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
