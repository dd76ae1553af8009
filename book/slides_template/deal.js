// Deal the cells of a page out to slides, when the formulas are drawn: a slide begins at each heading, and one below it
// where the next piece, a solution, does not fit. A piece taller than a slide shrinks.
document.addEventListener("DOMContentLoaded", async () => {
  await window.MathJax.startup.promise
  const slides = document.querySelector(".slides")
  const [width, height] = innerWidth < 600 ? [600, 1200] : [1280, 720] // a telephone is upright
  for (const [name, size] of Object.entries({ width, height })) slides.style.setProperty(`--${name}`, `${size}px`)
  const pieces = [...slides.querySelectorAll(".jp-Cell")].flatMap((cell) => {
    const text = cell.matches(".jp-MarkdownCell") ? ".jp-MarkdownOutput > *" : ".jp-Cell-inputWrapper, .jp-OutputArea-child"
    return [...cell.querySelectorAll(text)]
  })
  let column, page
  const turn = (begin) => {
    if (begin) slides.append((column = document.createElement("section")))
    column.append((page = document.createElement("section")))
    page.className = "jp-RenderedHTMLCommon"
  }
  const isFull = () => page.scrollHeight > page.clientHeight
  slides.classList.add("dealing")
  slides.replaceChildren()
  for (const piece of pieces) {
    if (piece.localName === "details") piece.open = true
    if (!page || piece.matches("h2")) turn(true)
    page.append(piece)
    if (isFull() && page.firstChild !== piece) {
      turn(false)
      page.append(piece)
    }
    if (isFull()) {
      const fits = 1 - (page.scrollHeight - page.clientHeight) / piece.offsetHeight
      Object.assign(piece.style, { zoom: Math.max(0.7, fits), display: "block", minHeight: 0, overflowY: "auto" })
    }
    // A solution alone on a slide is what its step shows: the slide would be empty before.
    if (piece.localName === "details") piece.classList.toggle("fragment", page.firstChild !== piece)
  }
  slides.classList.remove("dealing")
  Reveal.initialize({ width, height, center: false, margin: 0.03, display: "flex", hash: true, slideNumber: "c/t", transition: "none", scrollActivationWidth: 0 })
})
