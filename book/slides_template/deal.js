// Deal the cells of a page out to slides, when the formulas are drawn: a slide begins at each heading and where the next
// piece does not fit, but a heading goes below what fills less than half a slide. A heading of the first or second level
// begins a column. A piece taller than a slide shrinks, and one much taller scrolls.
document.addEventListener("DOMContentLoaded", async () => {
  await window.MathJax.startup.promise
  const slides = document.querySelector(".slides")
  const [width, height] = innerWidth < 600 ? [600, 1200] : [1280, 720] // a telephone is upright
  for (const [name, size] of Object.entries({ width, height })) slides.style.setProperty(`--${name}`, `${size}px`)
  const pieces = [...slides.querySelectorAll(".jp-Cell")].flatMap((cell) => {
    const text = cell.matches(".jp-MarkdownCell") ? ".jp-MarkdownOutput > *" : ".jp-Cell-inputWrapper, .jp-OutputArea-child"
    const parts = [...cell.querySelectorAll(text)]
    for (const part of parts) if (part.localName === "details") part.open = true
    return parts
  })
  let column, page
  const turn = (begin) => {
    if (begin) slides.append((column = document.createElement("section")))
    column.append((page = document.createElement("section")))
    page.className = "jp-RenderedHTMLCommon"
  }
  const isFull = () => page.scrollHeight > page.clientHeight
  const isHalf = () => page.lastChild.offsetTop + page.lastChild.offsetHeight - page.offsetTop > height / 2
  // The less room a picture needs at least, the fewer slides there are.
  const deal = (least) => {
    slides.style.setProperty("--least", `${least}px`)
    slides.replaceChildren()
    column = page = null
    for (const piece of pieces) {
      Object.assign(piece.style, { zoom: "", display: "", minHeight: "", overflowY: "" })
      if (!page) turn(true)
      else if (piece.matches("h2, h3") && (piece.matches(".slide") || isHalf() || column === slides.firstChild)) turn(piece.matches("h2"))
      page.append(piece)
      if (isFull() && page.firstChild !== piece) {
        const before = piece.previousSibling
        const leads = before.matches("p, h3") || (before.querySelector("img") && piece.matches(".jp-OutputArea-child"))
        turn(false)
        if (leads && before.previousSibling) page.append(before) // a sentence to its figure, a figure to its caption
        page.append(piece)
      }
      if (isFull()) {
        const fits = 1 - (page.scrollHeight - page.clientHeight) / piece.offsetHeight
        Object.assign(piece.style, { zoom: Math.max(0.7, fits), display: "block", minHeight: 0, overflowY: "auto" })
      }
    }
    // A solution alone on a slide is what its step shows: the slide would be empty before.
    for (const piece of pieces) if (piece.localName === "details") piece.classList.toggle("fragment", piece !== piece.parentNode.firstChild)
    return slides.querySelectorAll("section > section").length
  }
  slides.classList.add("dealing")
  for (const least of [260, 200, 140]) if (deal(least) <= 25) break
  slides.classList.remove("dealing")
  Reveal.initialize({ width, height, center: false, margin: 0.03, display: "flex", hash: true, slideNumber: "c/t", transition: "none", scrollActivationWidth: 0 })
})
