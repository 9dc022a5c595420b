(function () {
  "use strict";
  // plotly draws the 3-D views; without WebGL the still charts stay.
  var probe = document.createElement("canvas");
  if (!window.DecompressionStream || !(probe.getContext("webgl2") || probe.getContext("webgl"))) { return; }
  var dark = window.matchMedia("(prefers-color-scheme: dark)");

  function colour(role) {
    return getComputedStyle(document.documentElement).getPropertyValue("--c-" + role).trim();
  }

  function painted(value) {
    if (typeof value === "string") { return value.indexOf("role:") === 0 ? colour(value.slice(5)) : value; }
    if (Array.isArray(value)) { return value.length && typeof value[0] === "number" ? value : value.map(painted); }
    if (value && typeof value === "object") {
      var copy = {};
      Object.keys(value).forEach(function (key) { copy[key] = painted(value[key]); });
      return copy;
    }
    return value;
  }

  function layout(axes, camera) {
    function axis(title) {
      return {
        title: { text: title }, color: colour("ink"), gridcolor: colour("grid"), zerolinecolor: colour("grid"),
        showbackground: false, showspikes: false
      };
    }
    return {
      autosize: true, margin: { l: 0, r: 0, t: 0, b: 0 }, paper_bgcolor: "rgba(0,0,0,0)",
      font: { color: colour("ink"), size: 12 }, hoverlabel: { align: "left" },
      legend: { orientation: "h", x: 0.5, xanchor: "center", y: 1, itemsizing: "constant" },
      scene: {
        xaxis: axis(axes[0]), yaxis: axis(axes[1]), zaxis: axis(axes[2]), aspectmode: "data",
        camera: camera || { eye: { x: 1.5, y: -1.5, z: 0.9 }, center: { x: 0, y: 0, z: -0.1 } }
      }
    };
  }

  function turned(eye, move) {
    var radius = Math.hypot(eye.x, eye.y, eye.z), around = Math.atan2(eye.y, eye.x), above = Math.asin(eye.z / radius);
    if (move === "left") { around -= 0.26; }
    if (move === "right") { around += 0.26; }
    if (move === "up") { above = Math.min(above + 0.2, 1.5); }
    if (move === "down") { above = Math.max(above - 0.2, -1.5); }
    if (move === "near") { radius *= 0.85; }
    if (move === "far") { radius /= 0.85; }
    return {
      x: radius * Math.cos(above) * Math.cos(around), y: radius * Math.cos(above) * Math.sin(around),
      z: radius * Math.sin(above)
    };
  }

  function start(figure) {
    var view = JSON.parse(figure.querySelector("script[type='application/json']").textContent);
    var still = figure.querySelector(".still"), scene = figure.querySelector(".scene");
    var button = figure.querySelector(".switch"), moves = figure.querySelector(".moves");
    var drawn = false;

    function draw() {
      var camera = drawn ? scene.layout.scene.camera : null;
      var config = { displayModeBar: false, responsive: true };
      return window.Plotly.react(scene, painted(view.traces), layout(view.axes, camera), config).then(function () {
        drawn = true;
        scene.dataset.drawn = "yes";
      });
    }

    function turn(on) {
      still.hidden = on;
      scene.hidden = !on;
      moves.hidden = !on;
      button.setAttribute("aria-pressed", String(on));
      button.textContent = on ? "Show still image" : "Show in 3-D";
      if (on) { draw().catch(function () { turn(false); }); }
    }

    button.addEventListener("click", function () { turn(scene.hidden); });
    moves.addEventListener("click", function (event) {
      var move = event.target.dataset.move;
      if (move && drawn) {
        var eye = turned(scene.layout.scene.camera.eye, move);
        window.Plotly.relayout(scene, { "scene.camera.eye": eye });
      }
    });
    dark.addEventListener("change", function () { if (drawn) { draw(); } });
    figure.querySelector(".turning").hidden = false;
    if (figure.dataset.starts === "yes") { turn(true); }
  }

  // The page contains the library compressed; the content security policy allows it by its hash.
  function library() {
    var packed = Uint8Array.from(atob(document.getElementById("library").textContent), function (sign) {
      return sign.charCodeAt(0);
    });
    var stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(stream).text().then(function (text) {
      var script = document.createElement("script");
      script.textContent = text;
      document.body.appendChild(script);
      script.remove();
    });
  }

  library().then(function () { document.querySelectorAll("figure.turnable").forEach(start); });
}());
