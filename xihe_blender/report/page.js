// Dragging along the frames, the wipe, the marker of the shown frame, the copy button. All else works without it.
(() => {
  'use strict';
  const all = (query) => [...document.querySelectorAll(query)];
  const one = (query) => document.querySelector(query);
  const radios = all('input[name=moment]'), wipe = one('.wipe'), stage = one('.stage'), divider = one('.divider');

  function showWipe(index) {
    const kinds = [one('#wipe-left').value, one('#wipe-right').value];
    const sources = kinds.map((kind) => all('#m' + index + ' img').find((img) => img.dataset.kind === kind));
    const missing = kinds.filter((kind, i) => !sources[i]);
    [one('.over'), one('.under')].forEach((img, i) => {
      img.hidden = !sources[i];
      if (!sources[i]) { return; }
      img.src = sources[i].src;
      img.alt = sources[i].alt;
      stage.style.setProperty('--w', sources[i].getAttribute('width'));
      stage.style.setProperty('--h', sources[i].getAttribute('height'));
    });
    one('.absent').textContent = missing.length ? 'Not made for this frame: ' + missing.join(', ') : '';
  }

  function showFrame() {
    const index = radios.findIndex((radio) => radio.checked);
    if (index < 0) { return; }
    const x = radios[index].dataset.x + '%';
    all('line.now').forEach((line) => { line.setAttribute('x1', x); line.setAttribute('x2', x); });
    if (!wipe) { return; }
    one('[data-now]').textContent = 'at frame ' + radios[index].dataset.frame;
    showWipe(index);
  }
  radios.forEach((radio) => radio.addEventListener('change', showFrame));

  function scrub(event) {
    const under = event.buttons ? document.elementFromPoint(event.clientX, event.clientY) : null;
    const label = under && under.closest('.scrubber label');
    if (label && !label.control.checked) { label.control.checked = true; showFrame(); }
  }
  all('.scrubber').forEach((bar) => bar.addEventListener('pointermove', scrub));

  function moveDivider(share) {
    const percent = 100 * Math.min(1, Math.max(0, share));
    stage.style.setProperty('--cut', percent + '%');
    divider.setAttribute('aria-valuenow', Math.round(percent));
  }
  if (wipe) {
    const follow = (event) => {
      const box = stage.getBoundingClientRect();
      moveDivider((event.clientX - box.left) / box.width);
    };
    stage.addEventListener('pointerdown', (event) => {
      stage.setPointerCapture(event.pointerId);
      event.preventDefault();
      divider.focus({preventScroll: true});
      follow(event);
    });
    stage.addEventListener('pointermove', (event) => { if (event.buttons) { follow(event); } });
    divider.addEventListener('keydown', (event) => {
      const step = {ArrowLeft: -0.02, ArrowRight: 0.02}[event.key];
      if (!step) { return; }
      event.preventDefault();
      moveDivider(Number(divider.getAttribute('aria-valuenow')) / 100 + step);
    });
    all('.wipe select').forEach((select) => select.addEventListener('change', showFrame));
    moveDivider(0.5);
    wipe.hidden = false;
  }
  showFrame();

  const copy = one('#copy');
  if (copy && navigator.clipboard) {
    copy.hidden = false;
    copy.addEventListener('click', () => {
      navigator.clipboard.writeText(one('#command').textContent).then(() => { copy.textContent = 'Copied'; });
    });
  }
})();
