/* Held keys and a gamepad, from the browser to the server. viser's hotkeys do not tell that a key is still held, and it
   has no gamepad. This script writes the state of arrow keys, W A S D Q E and the first gamepad's sticks into a text field
   of the panel, which viser sends to the server, and turns the gamepad's buttons into hotkeys. It keeps these keys from
   viser's camera. FIELD is the first word of the field's text. */
(() => {
  if (window.fastmimicSteering) return;
  window.fastmimicSteering = true;
  const axes = {ArrowLeft: [1, 0, 0], KeyA: [1, 0, 0], ArrowRight: [-1, 0, 0], KeyD: [-1, 0, 0],
                ArrowUp: [0, 1, 0], KeyW: [0, 1, 0], ArrowDown: [0, -1, 0], KeyS: [0, -1, 0],
                KeyQ: [0, 0, 1], KeyE: [0, 0, -1]};
  const buttons = {0: ['p', 'KeyP'], 1: ['x', 'KeyX'], 4: ['[', 'PageUp', 'PageUp'], 5: [']', 'PageDown', 'PageDown'],
                   9: [' ', 'Space']};
  const held = new Set(), pressed = new Set();
  let last = null;
  const typing = (e) => e.target.closest && e.target.closest('input, textarea, select, [role=slider]');
  const signed = (v) => (v < 0 ? '-' : '+') + Math.abs(v).toFixed(2);
  const send = (text) => {
    if (text === last) return;
    const field = [...document.querySelectorAll('input')].find((i) => i.value.startsWith('FIELD '));
    if (!field) return;
    Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set.call(field, text);
    field.dispatchEvent(new Event('input', {bubbles: true}));
    last = text;
  };
  const update = () => {
    let x = 0, y = 0, z = 0;
    for (const code of held) { x += axes[code][0]; y += axes[code][1]; z += axes[code][2]; }
    const pad = [...(navigator.getGamepads ? navigator.getGamepads() : [])].find((p) => p);
    if (pad) {
      const dead = (v) => Math.abs(v) < 0.15 ? 0 : v;
      x -= dead(pad.axes[0] || 0);
      y -= dead(pad.axes[1] || 0);
      z -= dead(pad.axes[2] || 0);
      for (const [index, key] of Object.entries(buttons)) {
        const down = pad.buttons[index] && pad.buttons[index].pressed;
        if (down && !pressed.has(index)) {
          const name = key[2] || key[0];
          document.documentElement.dispatchEvent(
            new KeyboardEvent('keydown', {key: name, code: key[1], bubbles: true, cancelable: true}));
        }
        down ? pressed.add(index) : pressed.delete(index);
      }
    }
    const clip = (v) => Math.max(-1, Math.min(1, v));
    send(['FIELD', ...[x, y, z].map((v) => signed(clip(v)))].join(' '));
  };
  window.addEventListener('keydown', (e) => {
    if (!(e.code in axes) || typing(e) || e.ctrlKey || e.metaKey || e.altKey) return;
    held.add(e.code);
    e.preventDefault();
    e.stopImmediatePropagation();
    update();
  }, true);
  window.addEventListener('keyup', (e) => { if (held.delete(e.code)) update(); }, true);
  window.addEventListener('blur', () => { held.clear(); update(); });
  setInterval(update, 50);
})();
