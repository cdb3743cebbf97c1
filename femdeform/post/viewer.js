// The interactive view of a report: reads the data beside it, draws with Plotly, moves through the frames.
"use strict";
(function () {
  const source = document.getElementById("view3d-data");
  const target = document.getElementById("view3d");
  if (!source || !target || typeof Plotly === "undefined") return;
  const data = JSON.parse(source.textContent);

  function bytes(text) {
    const raw = atob(text);
    const array = new Uint8Array(raw.length);
    for (let k = 0; k < raw.length; k++) array[k] = raw.charCodeAt(k);
    return array.buffer;
  }

  const triangles = new Uint32Array(bytes(data.triangles));
  const lines = new Uint32Array(bytes(data.lines));
  const outline = new Float32Array(bytes(data.outline));
  const n = data.n_nodes;

  // Positions and values of a frame, from 16 bits of their range.
  const decoded = new Map();
  function frame(index) {
    if (!decoded.has(index)) {
      const packed = new Uint16Array(bytes(data.frames[index].positions));
      const values = new Uint16Array(bytes(data.frames[index].values));
      const axes = [0, 1, 2].map(function (c) {
        const scale = (data.high[c] - data.low[c]) / 65535;
        const axis = new Float32Array(n);
        for (let k = 0; k < n; k++) axis[k] = data.low[c] + scale * packed[3 * k + c];
        return axis;
      });
      decoded.set(index, { axes: axes, values: Float32Array.from(values, (v) => (v * data.largest) / 65535) });
    }
    return decoded.get(index);
  }

  // Lines are drawn as one path with gaps.
  function path(shown, c) {
    const result = [];
    for (let k = 0; k < lines.length; k += 2) {
      result.push(shown.axes[c][lines[k]], shown.axes[c][lines[k + 1]], null);
    }
    return result;
  }
  function pathValues(shown) {
    const result = [];
    for (let k = 0; k < lines.length; k += 2) {
      result.push(shown.values[lines[k]], shown.values[lines[k + 1]], shown.values[lines[k + 1]]);
    }
    return result;
  }
  function outlineAxis(c) {
    const result = [];
    for (let k = 0; k < outline.length; k += 6) result.push(outline[k + c], outline[k + 3 + c], null);
    return result;
  }
  function corner(c) {
    const result = new Uint32Array(triangles.length / 3);
    for (let k = 0; k < result.length; k++) result[k] = triangles[3 * k + c];
    return result;
  }

  const largest = data.largest > 0 ? data.largest : 1;
  const colorbar = { title: { text: data.label }, thickness: 14, len: 0.75, exponentformat: "e" };
  let current = data.frames.length - 1;
  const start = frame(current);
  const traces = [];
  let meshTrace = -1;
  let lineTrace = -1;
  if (triangles.length) {
    meshTrace = traces.length;
    traces.push({
      type: "mesh3d",
      x: start.axes[0], y: start.axes[1], z: start.axes[2],
      i: corner(0), j: corner(1), k: corner(2),
      intensity: start.values, cmin: 0, cmax: largest, colorscale: "Viridis", colorbar: colorbar,
      // Small bodies have small triangles, which the default thresholds take for degenerate ones.
      lighting: data.dim === 2
        ? { ambient: 1, diffuse: 0, specular: 0, fresnel: 0 }
        : { ambient: 0.5, diffuse: 0.7, specular: 0.1, roughness: 0.6,
            vertexnormalsepsilon: 1e-30, facenormalsepsilon: 1e-30 },
      flatshading: false,
      hovertemplate: "x %{x:.4g}<br>y %{y:.4g}<br>z %{z:.4g}<br>%{intensity:.4g}<extra></extra>",
    });
  }
  if (lines.length) {
    lineTrace = traces.length;
    traces.push({
      type: "scatter3d", mode: "lines", hoverinfo: "skip", showlegend: false,
      x: path(start, 0), y: path(start, 1), z: path(start, 2),
      line: { width: 6, color: pathValues(start), cmin: 0, cmax: largest, colorscale: "Viridis",
              showscale: !triangles.length, colorbar: colorbar },
    });
  }
  if (outline.length) {
    traces.push({
      type: "scatter3d", mode: "lines", hoverinfo: "skip", showlegend: false,
      x: outlineAxis(0), y: outlineAxis(1), z: outlineAxis(2),
      line: { width: 2, color: "#b0b0b0" },
    });
  }

  // The ranges are fixed for all frames, with the same scale along every axis.
  const extents = [0, 1, 2].map((c) => data.high[c] - data.low[c]);
  const size = Math.max(extents[0], extents[1], extents[2]) || 1;
  const ratio = extents.map((e) => Math.max(1.06 * e, 0.02 * size) / size);
  function axis(c, title) {
    const middle = 0.5 * (data.low[c] + data.high[c]);
    const half = 0.5 * ratio[c] * size;
    return { title: { text: title }, range: [middle - half, middle + half], autorange: false,
             visible: !(data.dim === 2 && c === 2), backgroundcolor: "#fafafa", gridcolor: "#dddddd",
             showbackground: data.dim === 3, zeroline: false, nticks: 6 };
  }
  // In parallel projection the distance of the eye does not matter, the size of the box does.
  const zoom = data.dim === 2 ? Math.min(2.3 / ratio[0], 1.45 / ratio[1]) : 1;
  const distance = 0.25 + 1.2 * Math.hypot(ratio[0], ratio[1], ratio[2]);
  const layout = {
    margin: { l: 0, r: 0, t: 0, b: 0 },
    paper_bgcolor: "white",
    uirevision: "keep",
    scene: {
      xaxis: axis(0, "x [m]"), yaxis: axis(1, "y [m]"), zaxis: axis(2, "z [m]"),
      aspectmode: "manual", aspectratio: { x: zoom * ratio[0], y: zoom * ratio[1], z: zoom * ratio[2] },
      dragmode: data.dim === 2 ? "pan" : "orbit",
      camera: {
        eye: { x: distance * data.eye[0], y: distance * data.eye[1], z: distance * data.eye[2] },
        up: { x: data.up[0], y: data.up[1], z: data.up[2] },
        projection: { type: data.dim === 2 ? "orthographic" : "perspective" },
      },
    },
  };
  // Named one by one: the default buttons include one that uploads the data of the plot.
  const buttons = [["toImage"], ["orbitRotation", "tableRotation", "pan3d", "zoom3d"], ["resetCameraDefault3d"]];
  Plotly.newPlot(target, traces, layout, {
    displaylogo: false, responsive: true, modeBarButtons: buttons, showSendToCloud: false, plotlyServerURL: "",
  });

  const slider = document.getElementById("view3d-slider");
  const time = document.getElementById("view3d-time");
  const play = document.getElementById("view3d-play");
  function show(index) {
    current = index;
    const shown = frame(index);
    slider.value = index;
    time.textContent = "t = " + Number(data.frames[index].time.toPrecision(4)) + " s";
    if (meshTrace >= 0) {
      Plotly.restyle(target, { x: [shown.axes[0]], y: [shown.axes[1]], z: [shown.axes[2]],
                               intensity: [shown.values] }, [meshTrace]);
    }
    if (lineTrace >= 0) {
      Plotly.restyle(target, { x: [path(shown, 0)], y: [path(shown, 1)], z: [path(shown, 2)],
                               "line.color": [pathValues(shown)] }, [lineTrace]);
    }
  }
  slider.max = data.frames.length - 1;
  slider.value = current;
  time.textContent = "t = " + Number(data.frames[current].time.toPrecision(4)) + " s";
  slider.addEventListener("input", () => show(Number(slider.value)));
  let timer = null;
  play.addEventListener("click", function () {
    if (timer === null) {
      play.textContent = "Pause";
      timer = setInterval(() => show((current + 1) % data.frames.length),
                          Math.max(80, 4000 / data.frames.length));
    } else {
      clearInterval(timer);
      timer = null;
      play.textContent = "Play";
    }
  });
  if (data.frames.length < 2) document.getElementById("view3d-controls").hidden = true;
})();
