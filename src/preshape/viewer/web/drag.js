const i = event.target.dataset.i, d = event.currentTarget.dataset, id = event.currentTarget.id;
if (i !== undefined) {
  event.preventDefault();
  // The page may replace curve and input box during a drag, so both are looked up for every event.
  const find = () => [...document.querySelectorAll('label')].find(l => l.textContent === d.box)
    .closest('div:has(input)').querySelector('input');
  const write = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set;
  const move = e => {
    const svg = document.getElementById(id), r = svg && svg.getBoundingClientRect(), v = svg && svg.viewBox.baseVal;
    if (!r || !r.width) return;  // the curve is being replaced, or its tab is hidden
    const at = d.axis === 'x' ? (e.clientX - r.left) / r.width * v.width : (e.clientY - r.top) / r.height * v.height;
    const box = find(), numbers = box.value.split(' ').map(Number);
    let low = +d.low, high = +d.high, x = low + (at - d.from) / (d.to - d.from) * (high - low);
    if (+d.sort) { low = i > 0 ? numbers[i - 1] : low; high = i < numbers.length - 1 ? numbers[+i + 1] : high; }
    numbers[i] = Math.round(100 * Math.max(low, Math.min(high, x))) / 100;
    write.call(box, numbers.join(' '));
    box.dispatchEvent(new Event('input', {bubbles: true}));
  };
  const end = () => { window.removeEventListener('pointermove', move); window.removeEventListener('pointerup', end);
    window.removeEventListener('pointercancel', end); };
  window.addEventListener('pointermove', move); window.addEventListener('pointerup', end); window.addEventListener('pointercancel', end);
}
