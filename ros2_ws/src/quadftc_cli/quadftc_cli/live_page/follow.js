// Moves the camera of a 3D scene along with the vehicle; how it looks at it is the user's.
export default {
  template: "<div style='display: none'></div>",
  props: { scene: Number, start: Array },
  mounted() {
    this.place = this.start;
  },
  methods: {
    follow(place) {
      const scene = getElement(this.scene);
      if (!scene?.controls) return;
      for (const point of [scene.camera.position, scene.controls.target]) {
        point.set(...["x", "y", "z"].map((axis, k) => point[axis] + place[k] - this.place[k]));
      }
      this.place = place;
    },
  },
};
