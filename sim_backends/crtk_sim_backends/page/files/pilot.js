// What the page commands. A jog is asked for again and again while a button is pressed: release, a window that is
// hidden or loses the focus, and a lost connection end it; the other side ends it too when nothing comes any more.

const AGAIN = 50; // ms from one word to the next

export class Pilot {
  // `send` takes a command.
  constructor(send) {
    this.send = send;
    this.share = 0.4; // of the full speed
    this.press = 0;
    this.pressed = null; // {button, command, timer}
    for (const each of ["blur", "pagehide"]) addEventListener(each, () => this.release());
    document.addEventListener("visibilitychange", () => document.hidden && this.release());
  }

  ask(device, what, more = {}) {
    if (what === "hold" || what === "disable") this.release();
    this.send({ do: what, device, ...more });
  }

  // Let a button jog as long as it is pressed, by a pointer, or by the space bar while it has the focus.
  jogs(button, command, sign) {
    button.onpointerdown = (event) => {
      if (event.button !== 0) return;
      button.setPointerCapture(event.pointerId);
      this.begin(button, command, sign);
    };
    button.onpointerup = button.onpointercancel = button.onlostpointercapture = () => this.release();
    button.onkeydown = (event) => {
      if (event.key !== " ") return;
      event.preventDefault();
      if (!event.repeat) this.begin(button, command, sign);
    };
    button.onkeyup = button.onblur = () => this.release();
    button.oncontextmenu = (event) => event.preventDefault();
  }

  begin(button, command, sign) {
    this.release();
    this.press += 1;
    button.classList.add("pressed");
    const say = () => this.send({ do: "jog", ...command, speed: sign * this.share, press: this.press });
    this.pressed = { button, command, timer: setInterval(say, AGAIN) };
    say();
  }

  // Say that the button is up.
  release() {
    if (!this.pressed) return;
    this.send({ do: "release", device: this.pressed.command.device });
    this.lost();
  }

  // There is nobody to say it to.
  lost() {
    if (!this.pressed) return;
    clearInterval(this.pressed.timer);
    this.pressed.button.classList.remove("pressed");
    this.pressed = null;
  }
}
