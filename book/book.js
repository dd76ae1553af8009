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

// Sliders over stored pictures: one moves, the others go back to where they were at first.
document.addEventListener("DOMContentLoaded", () => {
  for (const box of document.querySelectorAll(".stills")) {
    const sliders = [...box.querySelectorAll("input")], pictures = [...box.querySelectorAll("[data-slider]")]
    box.addEventListener("input", ({ target }) => {
      for (const slider of sliders) {
        if (slider !== target) slider.value = slider.defaultValue
        slider.nextElementSibling.textContent = JSON.parse(slider.dataset.values)[slider.value]
      }
      const moved = target.value === target.defaultValue ? sliders[0] : target
      const [slider, place] = [sliders.indexOf(moved), moved.value].map(String)
      for (const picture of pictures)
        picture.hidden = picture.dataset.slider !== slider || picture.dataset.place !== place
    })
  }
})
