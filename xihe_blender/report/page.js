// Dragging along the frames, the wipe, the marker of the shown frame, the copy button. All else works without it.
(function () {
  'use strict';
  var all = function (query) { return Array.prototype.slice.call(document.querySelectorAll(query)); };
  var one = function (query) { return document.querySelector(query); };
  var radios = all('input[name=moment]');
  var wipe = one('.wipe');

  function showWipe(index) {
    var kinds = [one('#wipe-left').value, one('#wipe-right').value];
    var sources = kinds.map(function (kind) {
      return all('#m' + index + ' img').find(function (img) { return img.dataset.kind === kind; });
    });
    var missing = kinds.filter(function (kind, i) { return !sources[i]; });
    [one('.over'), one('.under')].forEach(function (img, i) {
      img.hidden = !sources[i];
      if (!sources[i]) { return; }
      img.src = sources[i].src;
      img.alt = sources[i].alt;
      one('.stage').style.setProperty('--w', sources[i].getAttribute('width'));
      one('.stage').style.setProperty('--h', sources[i].getAttribute('height'));
    });
    one('.absent').textContent = missing.length ? 'Not made for this frame: ' + missing.join(', ') : '';
  }

  function showFrame() {
    radios.forEach(function (radio, index) {
      if (!radio.checked) { return; }
      all('line.now').forEach(function (line) {
        line.setAttribute('x1', radio.dataset.x + '%');
        line.setAttribute('x2', radio.dataset.x + '%');
      });
      if (!wipe) { return; }
      one('[data-now]').textContent = 'at frame ' + radio.dataset.frame;
      showWipe(index);
    });
  }
  radios.forEach(function (radio) { radio.addEventListener('change', showFrame); });

  function scrub(event) {
    if (!event.buttons) { return; }
    var under = document.elementFromPoint(event.clientX, event.clientY);
    var label = under && under.closest('.scrubber label');
    if (label && !label.control.checked) { label.control.checked = true; showFrame(); }
  }
  all('.scrubber').forEach(function (bar) { bar.addEventListener('pointermove', scrub); });

  function moveDivider(share) {
    var clipped = Math.min(1, Math.max(0, share));
    one('.stage').style.setProperty('--cut', 100 * clipped + '%');
    one('.divider').setAttribute('aria-valuenow', Math.round(100 * clipped));
  }
  if (wipe) {
    var stage = one('.stage'), divider = one('.divider');
    var follow = function (event) {
      var box = stage.getBoundingClientRect();
      moveDivider((event.clientX - box.left) / box.width);
    };
    stage.addEventListener('pointerdown', function (event) {
      stage.setPointerCapture(event.pointerId);
      event.preventDefault();
      divider.focus({preventScroll: true});
      follow(event);
    });
    stage.addEventListener('pointermove', function (event) { if (event.buttons) { follow(event); } });
    divider.addEventListener('keydown', function (event) {
      var step = {ArrowLeft: -0.02, ArrowRight: 0.02}[event.key];
      if (!step) { return; }
      event.preventDefault();
      moveDivider(Number(divider.getAttribute('aria-valuenow')) / 100 + step);
    });
    all('.wipe select').forEach(function (select) { select.addEventListener('change', showFrame); });
    moveDivider(0.5);
    wipe.hidden = false;
  }
  showFrame();

  var copy = one('#copy');
  if (copy && navigator.clipboard) {
    copy.hidden = false;
    copy.addEventListener('click', function () {
      navigator.clipboard.writeText(one('#command').textContent).then(function () { copy.textContent = 'Copied'; });
    });
  }
})();
