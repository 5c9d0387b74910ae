// What is known of a scene before it is drawn, and what is selected in it.

const agents = data.scene.agents;

const keyframes = {
  count: data.scene.keyframes.count,
  agent: unpack(data.scene.keyframes.agent, Uint32Array),
  id: unpack(data.scene.keyframes.id, Uint32Array),
  frame: unpack(data.scene.keyframes.frame, Float64Array),
  timestamp: unpack(data.scene.keyframes.timestamp, Float64Array),
  pose: unpack(data.scene.keyframes.pose, Float32Array),
  depths: unpack(data.scene.keyframes.depths, Uint32Array),
  /** The camera that took a keyframe. */
  camera(index) {
    return agents[this.agent[index]].camera;
  },
  /** Axis 0–2 or centre 3 of a keyframe. */
  column(index, column) {
    return Array.from(this.pose.subarray(index * 12 + column * 3, index * 12 + column * 3 + 3));
  },
  /** The keyframe whose frame lies nearest; −1 without keyframes. */
  nearest(frame) {
    let best = -1;
    for (let i = 0; i < this.count; i++) {
      if (best < 0 || Math.abs(this.frame[i] - frame) < Math.abs(this.frame[best] - frame)) best = i;
    }
    return best;
  },
};

const trajectory = {
  count: data.scene.trajectory.count,
  agent: unpack(data.scene.trajectory.agent, Uint32Array),
  frame: unpack(data.scene.trajectory.frame, Float64Array),
  timestamp: unpack(data.scene.trajectory.timestamp, Float64Array),
  position: unpack(data.scene.trajectory.position, Float32Array),
};

/** First and end index of each agent's run in an ascending array of agents. */
function spans(owners) {
  const found = agents.map(() => [0, 0]);
  owners.forEach((agent, i) => {
    if (i === 0 || owners[i - 1] !== agent) found[agent][0] = i;
    found[agent][1] = i + 1;
  });
  return found;
}

/** An agent's colour, as CSS reads it. */
const agentColour = (agent) => `rgb(${agents[agent].color.join(" ")})`;

/** What is selected and pointed at (a place on the plots' x axis); parts of the page listen for changes. */
const shared = {
  selected: -1,
  hoverAt: null,
  listeners: [],
  onChange(listener) {
    this.listeners.push(listener);
  },
  select(keyframe) {
    if (keyframe === this.selected || keyframe < 0 || keyframe >= keyframes.count) return;
    this.selected = keyframe;
    this.listeners.forEach((f) => f("selected"));
  },
  hover(at) {
    if (at === this.hoverAt) return;
    this.hoverAt = at;
    this.listeners.forEach((f) => f("hover"));
  },
};

/** The image of each keyframe that has one, for the 3-D view and elsewhere. */
const pictureImages = new Map();

/** The image of a picture; its text is given up. */
function takeImage(picture) {
  const image = new Image();
  image["src"] = "data:image/jpeg;base64," + picture.jpeg;
  picture.jpeg = null;
  if (picture.keyframe !== null) pictureImages.set(picture.keyframe, image);
  return image;
}
