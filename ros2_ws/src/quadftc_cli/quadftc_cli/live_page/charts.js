// Keeps the rows of the last seconds, and draws them into the charts of the page.
export default {
  template: "<div style='display: none'></div>",
  props: { charts: Array, window: Number },
  mounted() {
    this.rows = [];
    this.axis = 0;
    this.drawn = 0;
    this.timer = setInterval(() => this.draw(), 100);
  },
  beforeUnmount() {
    clearInterval(this.timer);
  },
  methods: {
    push(rows) {
      this.rows.push(...rows);
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
        const series = columns.map(([first, byAxis]) => {
          const column = first + (byAxis ? this.axis : 0);
          return { data: this.rows.map((row) => [row[0] - now, row[column]]) };
        });
        chart?.setOption({ series }, { lazyUpdate: true });
      }
      this.drawn += 1;
    },
  },
};
