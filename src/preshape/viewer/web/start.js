// Runs before viser's script. First: a tab's page has a random number, which goes with its connection, so that the
// server shows the same again after a reload or a lost connection. viser opens the connection in a worker.
(() => {
  let page = '';
  try {
    const bytes = crypto.getRandomValues(new Uint8Array(16));
    page = sessionStorage.page ||= [...bytes].map(b => b.toString(16).padStart(2, '0')).join('');
  } catch { return; }  // a browser that stores nothing begins anew
  const post = Worker.prototype.postMessage;
  Worker.prototype.postMessage = function (data, ...more) {
    if (data && data.type === 'set_server' && data.server) {
      const place = new URL(data.server, location.href);
      place.searchParams.set('page', page);
      data = {...data, server: place.href};
    }
    return post.call(this, data, ...more);
  };
})();
// Second: a headline that changes scrolls into sight, however far down its panel was scrolled to press a button.
addEventListener('DOMContentLoaded', () => {
  let told = '';
  new MutationObserver(() => {
    const head = document.querySelector('.ps .head'), title = head && head.querySelector('b').textContent;
    if (!title || title === told) return;
    told = title;
    head.scrollIntoView({block: 'nearest'});
  }).observe(document.body, {childList: true, characterData: true, subtree: true});
});
// Third: the number of samples per pixel.
(() => {
  const probe = document.createElement('canvas').getContext('webgl');
  const named = probe && probe.getExtension('WEBGL_debug_renderer_info');
  const renderer = named ? probe.getParameter(named.UNMASKED_RENDERER_WEBGL) : '';
  const software = /swiftshader|llvmpipe|softpipe|software/i.test(renderer);
  const make = HTMLCanvasElement.prototype.getContext;
  HTMLCanvasElement.prototype.getContext = function (kind, wanted) {
    if (!kind.startsWith('webgl')) return make.call(this, kind, wanted);
    // The server gets the size on the screen, not that of the buffer: label layout and phone detection need it.
    for (const [side, seen] of [['width', 'clientWidth'], ['height', 'clientHeight']]) {
      const {get, set} = Object.getOwnPropertyDescriptor(HTMLCanvasElement.prototype, side);
      Object.defineProperty(this, side, {configurable: true, set, get() { return this[seen] || get.call(this); }});
    }
    return make.call(this, kind, software ? {...wanted, antialias: false, preserveDrawingBuffer: false} : wanted);
  };
  if (!software) return;
  // With software rendering every sample costs CPU time: few samples while the view moves, many when it rests.
  const MOVING = 0.6, RESTING = 1.5, REST = 350;
  const inner = name => window[name] || {};
  let held = false, timer = 0;
  const draw = ratio => {
    const settings = inner('__viserTestpoints').devSettings, back = inner('__viserMutable').backgroundMaterial;
    if (back) back.visible = false;  // viser draws a background image, which this scene does not have
    if (settings && settings.get().fixedDpr !== ratio) settings.set({fixedDpr: ratio});
  };
  const rest = () => held || draw(RESTING * devicePixelRatio);
  const move = () => {
    draw(MOVING * devicePixelRatio);
    clearTimeout(timer);
    timer = setTimeout(rest, REST);
  };
  const scene = event => event.target instanceof HTMLCanvasElement;
  addEventListener('pointerdown', event => { if (scene(event)) held = true; }, true);
  addEventListener('pointermove', () => { if (held) move(); }, true);
  for (const end of ['pointerup', 'pointercancel', 'blur'])
    addEventListener(end, () => { if (held) { held = false; move(); } }, true);
  addEventListener('wheel', event => { if (scene(event)) move(); }, {capture: true, passive: true});
  const begin = () => (inner('__viserTestpoints').devSettings ? rest() : setTimeout(begin, 100));
  addEventListener('DOMContentLoaded', begin);
})();
