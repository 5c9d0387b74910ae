//! The time and memory that a run takes.

use serde::Serialize;

/// Time and memory.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Cost {
    /// Seconds from the first frame to the finished map.
    pub wall_s: f64,
    /// CPU seconds of all threads, decoding included.
    pub cpu_s: Option<f64>,
    /// Processed frames per wall second.
    pub frames_per_s: f64,
    /// Mean time the agent took for a frame, milliseconds.
    pub mean_ms: f64,
    /// 99th percentile of it.
    pub p99_ms: f64,
    /// The longest.
    pub max_ms: f64,
    /// Largest resident memory of the process, bytes.
    pub peak_memory_bytes: Option<u64>,
    /// How old images were when their pose was known; of cameras and with `--realtime`.
    pub latency_ms: Option<Latency>,
}

impl Cost {
    /// The cost of frames that took `ms` each, in a run of `wall_s` seconds.
    pub fn new(mut ms: Vec<f64>, wall_s: f64, cpu_s: Option<f64>, peak_memory_bytes: Option<u64>) -> Self {
        ms.sort_by(f64::total_cmp);
        let count = ms.len();
        Self {
            wall_s,
            cpu_s,
            frames_per_s: if wall_s > 0.0 { count as f64 / wall_s } else { 0.0 },
            mean_ms: if count > 0 { ms.iter().sum::<f64>() / count as f64 } else { 0.0 },
            p99_ms: percentile(&ms, 99).unwrap_or(0.0),
            max_ms: ms.last().copied().unwrap_or(0.0),
            peak_memory_bytes,
            latency_ms: None,
        }
    }
}

/// From the moment an image is taken (in a replay by time stamps: is due) until its pose is known, milliseconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Latency {
    /// Half of the frames are faster.
    pub median: f64,
    /// 99th percentile.
    pub p99: f64,
    /// The longest.
    pub max: f64,
}

impl Latency {
    /// Of frames that took so long each; `None` without frames.
    pub fn of(mut ms: Vec<f64>) -> Option<Self> {
        ms.sort_by(f64::total_cmp);
        Some(Self { median: percentile(&ms, 50)?, p99: percentile(&ms, 99)?, max: *ms.last()? })
    }
}

/// The nearest-rank percentile of sorted values: the smallest that `percent` % of them do not exceed.
pub(super) fn percentile(sorted: &[f64], percent: usize) -> Option<f64> {
    sorted.get((sorted.len() * percent).div_ceil(100).saturating_sub(1)).copied()
}
