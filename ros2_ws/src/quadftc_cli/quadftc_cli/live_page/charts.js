// Keeps the rows of the last seconds, and draws them into the charts of the page.
export default {
  template: "<div style='display: none'></div>",
  props: { charts: Array, window: Number, map: Number },
  mounted() {
    this.rows = [];
    this.axis = 0;
    this.drawn = 0;
    this.timer = setInterval(() => this.draw(), 100);
    window.addEventListener("resize", this.refresh);
  },
  beforeUnmount() {
    clearInterval(this.timer);
    window.removeEventListener("resize", this.refresh);
  },
  methods: {
    refresh() {
      this.stale = true;
    },
    push(rows) {
      this.rows = [...this.rows.filter((row) => row[0] < rows[0][0]), ...rows]; // a recording may go back
      const begin = this.rows[this.rows.length - 1][0] - this.window;
      const first = this.rows.findIndex((row) => row[0] >= begin);
      this.rows.splice(0, first);
      this.stale = true;
    },
    choose(axis) {
      this.axis = axis;
      this.stale = true;
    },
    draw() {
      if (!this.stale || document.hidden) return;
      this.stale = false;
      const now = this.rows.length ? this.rows[this.rows.length - 1][0] : 0;
      for (const { id, columns } of this.charts) {
        const chart = getElement(id)?.chart;
        if (id === this.map) {
          this.drawMap(chart, columns);
          continue;
        }
        const series = columns.map(([first, byAxis]) => {
          const column = first + (byAxis ? this.axis : 0);
          return { data: this.rows.map((row) => [row[0] - now, row[column]]) };
        });
        chart?.setOption({ series }, { lazyUpdate: true });
      }
      this.drawn += 1;
    },
    // x to the right, y up, to one scale: a square around the middle of the path
    drawMap(chart, columns) {
      if (!chart) return;
      const paths = columns.map(([first]) =>
        this.rows.map((row) => [row[first], row[first + 1]]).filter((place) => place.every(Number.isFinite)),
      );
      const places = paths.flat();
      if (!places.length) return;
      const [x, y] = [0, 1].map((k) => {
        const values = places.map((place) => place[k]);
        return [Math.min(...values), Math.max(...values)];
      });
      const span = Math.max(1, 1.2 * (y[1] - y[0]), 1.2 * (x[1] - x[0]));
      const scale = (chart.getWidth() - 62) / Math.max(chart.getHeight() - 60, 1); // without the margins
      const around = ([low, high], half) => {
        const middle = Math.round(5 * (low + high)) / 10;
        return { min: Math.round(10 * (middle - half)) / 10, max: Math.round(10 * (middle + half)) / 10 };
      };
      const last = paths[1][paths[1].length - 1];
      chart.setOption(
        {
          xAxis: around(x, (span * Math.max(scale, 1)) / 2),
          yAxis: around(y, (span * Math.max(1 / scale, 1)) / 2),
          series: [{ data: paths[0] }, { data: paths[1], markPoint: { data: last ? [{ coord: last }] : [] } }],
        },
        { lazyUpdate: true },
      );
    },
  },
};
