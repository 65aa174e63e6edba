// Moves the camera of a 3D scene after the vehicle; how it looks at it is the user's.
export default {
  template: "<div style='display: none'></div>",
  props: { scene: Number, start: Array, slack: Number },
  mounted() {
    this.place = this.start; // what the camera looks at
    this.vehicle = this.start;
    this.timer = setInterval(() => this.step(), 33);
  },
  beforeUnmount() {
    clearInterval(this.timer);
  },
  methods: {
    follow(place) {
      this.vehicle = place;
    },
    // Comes after the vehicle within seconds, and keeps it in view: so the eye sees it move.
    step() {
      const scene = getElement(this.scene);
      if (!scene?.controls) return;
      const away = this.vehicle.map((value, k) => value - this.place[k]);
      const distance = Math.hypot(...away);
      if (distance < 1e-3) return;
      const share = Math.max(0.015, 1 - this.slack / distance);
      const move = away.map((value) => share * value);
      for (const point of [scene.camera.position, scene.controls.target]) {
        point.set(...["x", "y", "z"].map((axis, k) => point[axis] + move[k]));
      }
      this.place = this.place.map((value, k) => value + move[k]);
    },
  },
};
