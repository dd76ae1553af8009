// Deal the cells of a page out to slides, when the formulas are drawn: a slide begins at each heading, and a further one
// where the next piece, a solution, does not fit. A piece taller than a slide shrinks.
document.addEventListener("DOMContentLoaded", async () => {
  await window.MathJax.startup.promise
  const slides = document.querySelector(".slides"), phone = innerWidth < 600
  const [width, height] = phone ? [600, Math.round((600 * innerHeight) / innerWidth)] : [1280, 720]
  for (const [name, size] of Object.entries({ width, height })) slides.style.setProperty(`--${name}`, `${size}px`)
  letPan(slides)
  const groups = []
  for (const piece of slides.querySelectorAll(".jp-MarkdownOutput > *, .jp-CodeCell .jp-Cell-inputWrapper, .jp-CodeCell .jp-OutputArea-child")) {
    if (piece.matches("h1, h2")) groups.push([])
    groups.at(-1).push(piece)
  }
  let page
  const turn = () => {
    slides.append((page = document.createElement("section")))
    page.className = "jp-RenderedHTMLCommon"
  }
  const isFull = () => page.scrollHeight > page.clientHeight
  slides.classList.add("dealing")
  slides.classList.toggle("phone", phone)
  slides.replaceChildren()
  for (const pieces of groups.flatMap((pieces) => cut(pieces, phone, width, height))) {
    turn()
    for (const piece of pieces) {
      if (piece.localName === "details") piece.open = true
      page.append(piece)
      if (isFull() && page.firstChild !== piece) {
        turn()
        page.append(piece)
      }
      if (isFull()) {
        const fits = 1 - (page.scrollHeight - page.clientHeight) / piece.offsetHeight
        Object.assign(piece.style, { zoom: Math.max(0.7, fits), display: "block", minHeight: 0, overflowY: "auto" })
      }
      const formula = piece.querySelector("mjx-container[display] svg")
      if (formula) piece.style.zoom = Math.min(1, (width - 56) / formula.getBoundingClientRect().width)
      // A solution alone on a slide is what its step shows: the slide would be empty before.
      if (piece.localName === "details") piece.classList.toggle("fragment", page.firstChild !== piece)
    }
  }
  // Code grows as long as it fits and no line breaks that did not break before.
  for (page of phone ? [] : slides.children) {
    const lines = () => [...page.querySelectorAll("pre")].map((pre) => Math.round(pre.offsetHeight / parseFloat(getComputedStyle(pre).fontSize) / 1.2)).join()
    const before = lines()
    for (let size = 44; before && size >= 24; size -= 2) {
      page.style.setProperty("--code", `${size}px`)
      if (!isFull() && lines() === before) break
    }
  }
  slides.classList.remove("dealing")
  matchMedia("(max-width: 599px)").addEventListener("change", () => location.reload())
  await Reveal.initialize({ width, height, center: false, margin: 0, maxScale: 4, display: "flex", hash: true, slideNumber: "c/t", transition: "none", scrollActivationWidth: 0 })
})

// Labels are to be read: from the last row, px of a slide of 1280; on a telephone, which two fingers enlarge, of 600.
const LEGIBLE = [13, 12]

// Return the slides that the pieces of one become: its picture, where its labels are too small, in parts beside each other,
// or, if these are too small as well, a slide for each part.
function cut(pieces, phone, width, height) {
  const at = pieces.findIndex((piece) => piece.matches(".picture")), image = pieces[at]?.firstChild
  if (!image) return [pieces]
  const [w, h] = ["width", "height"].map((side) => +image.getAttribute(side)), { label, rows, columns } = pieces[at].dataset
  const boxes = phone
    ? JSON.parse(columns).map(([from, to]) => [from, 0, to - from, h])
    : JSON.parse(rows).map(([from, to]) => [0, from, w, to - from])
  const room = height - (phone ? 360 : 140), least = LEGIBLE[+phone] / label // below the title, above the sentence
  const most = (side) => Math.max(...boxes.map((box) => box[side]))
  const scale = (across) => Math.min(width / (across * most(2)), room / (Math.ceil(boxes.length / across) * most(3)))
  const across = boxes.map((_, i) => i + 1).sort((a, b) => scale(b) - scale(a))[0]
  // A finger can move what is wide, a projector's audience cannot.
  if (boxes.length === 1 || (phone ? scale(across) < 0.75 * least : Math.min(width / w, room / h) >= least)) {
    if (phone) pieces[at].style.setProperty("--part", `${Math.min(Math.max(width, least * w), (room * w) / h)}px`)
    return [pieces]
  }
  const parts = boxes.map((box) => part(image, w, h, box, most))
  const shown = (parts, across) =>
    pieces.map((piece, i) => {
      const copy = piece.cloneNode(i !== at) // a picture without its image
      if (i === at) copy.append(...parts), copy.style.setProperty("--across", across)
      if (i === at && phone) copy.style.setProperty("--part", `${scale(across) * most(2)}px`)
      return copy
    })
  if (phone || scale(across) >= least) return [shown(parts, across)]
  const one = pieces[0].matches("h1") ? [parts[parts.length >> 1]] : parts
  return one.map((part) => shown([part], 1))
}

// Return a part of an image, on paper as large as the largest part: what is the same in them stands in the same place.
function part(image, width, height, [x, y, w, h], most) {
  const made = (name, facts, ...inside) => {
    const element = document.createElementNS("http://www.w3.org/2000/svg", name)
    for (const [key, value] of Object.entries(facts)) element.setAttribute(key, value)
    element.append(...inside)
    return element
  }
  const picture = made("image", { href: image.src, width, height })
  const window = made("svg", { width: w, height: h, viewBox: [x, y, w, h] }, picture)
  return made("svg", { viewBox: [0, 0, most(2), most(3)], role: "img", "aria-label": image.alt }, window)
}

// Let a finger move what is wider than a telephone, a panorama from its middle; an edge beyond which more follows fades.
// Where it is at its end already, the finger turns to the next slide.
function letPan(slides) {
  let from, ends
  const mark = (box) => {
    const rest = box.scrollWidth - box.clientWidth
    box.classList.toggle("less", rest > 1 && box.scrollLeft > 1)
    box.classList.toggle("more", rest - box.scrollLeft > 1)
  }
  for (const event of ["ready", "slidechanged"])
    Reveal.on(event, ({ currentSlide }) => {
      for (const box of currentSlide.querySelectorAll(".picture, pre")) {
        const shown = box.matches(".picture") ? box.firstChild : null
        const share = /panorama/i.test(shown?.alt ?? shown?.ariaLabel) ? 0.5 : 0
        if (shown) box.scrollLeft = (box.scrollWidth - box.clientWidth) * share
        mark(box)
      }
    })
  slides.addEventListener("scroll", ({ target }) => mark(target), true)
  slides.addEventListener("touchstart", ({ touches, target }) => {
    const box = target.closest(".picture, pre"), rest = box ? box.scrollWidth - box.clientWidth : 0
    ;[from, ends] = [touches[0].clientX, rest > 1 ? { prev: box.scrollLeft < 1, next: box.scrollLeft > rest - 1 } : {}]
  })
  slides.addEventListener("touchend", ({ changedTouches }) => {
    const way = changedTouches[0].clientX < from ? "next" : "prev"
    if (ends[way] && Math.abs(changedTouches[0].clientX - from) > 40) Reveal[way]()
  })
}
