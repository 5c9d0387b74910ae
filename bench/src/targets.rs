//! What to compare with.

/// Figures of another system on a sequence, and what loopbox is to reach.
pub struct Target {
    /// Name of the sequence.
    pub name: &'static str,
    /// DSO (default preset, no photometric calibration): ATE RMSE over the frames it tracked, Sim(3)-aligned; frames
    /// tracked; CPU per frame, on another machine than the one that the tables are made on.
    pub dso: &'static str,
    /// Largest ATE RMSE, metres.
    pub ate_m: f64,
    /// Largest CPU time per frame, milliseconds: that of DSO on its machine, or less.
    pub cpu_ms: f64,
    /// The first frame whose ground truth holds.
    pub truth_from: usize,
}

/// The sequences with figures to compare.
const TARGETS: [Target; 6] = [
    Target {
        name: "kitti00_first201",
        dso: "1.13 m · 195/201 · 96 ms",
        ate_m: 1.0,
        cpu_ms: 96.0,
        truth_from: 15,
    },
    Target { name: "parking_a", dso: "1.1 cm · 327/333 · 60 ms", ate_m: 0.02, cpu_ms: 60.0, truth_from: 0 },
    Target {
        name: "parking_b",
        dso: "0.4 cm · 208/266, five restarts · 80 ms",
        ate_m: 0.02,
        cpu_ms: 80.0,
        truth_from: 0,
    },
    Target { name: "parking_c", dso: "0.8 cm · 194/200 · 60 ms", ate_m: 0.02, cpu_ms: 60.0, truth_from: 0 },
    Target {
        name: "tum_fr1_desk",
        dso: "31.5 cm · 542/613, five restarts · 36 ms",
        ate_m: 0.03,
        cpu_ms: 36.0,
        truth_from: 0,
    },
    Target {
        name: "tum_fr1_xyz",
        dso: "6.3 cm · 792/798 · 24–33 ms",
        ate_m: 0.015,
        cpu_ms: 20.0,
        truth_from: 0,
    },
];

/// The sequences whose images are drawn by a program; all others are of real cameras.
const RENDERED: [&str; 3] = ["parking_a", "parking_b", "parking_c"];

/// Where a sequence's images come from, for people: `real` or `rendered`.
pub fn images(name: &str) -> &'static str {
    if RENDERED.contains(&name) { "rendered" } else { "real" }
}

/// The figures for a sequence, if there are any.
pub fn target(name: &str) -> Option<&'static Target> {
    TARGETS.iter().find(|target| target.name == name)
}
