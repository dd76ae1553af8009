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
