//! Makes the time of a recording grow: decides which stamps are those of its clock, and where that clock was set.
//!
//! A stamp that lies off those around it is wrong (a message with damaged bytes, a header that was not filled in),
//! and its frame is left out. Stamps that grow, but from an earlier time on, come from a clock that was set: by NTP,
//! by a host that had no time yet, or by a recording that was played again. The recording continues, and so does its
//! time. A leap forward is a pause and stays as recorded, but a leap of more than a day is a clock that was set as
//! well.
//!
//! [`Clock`] decides, as a function of stamps; [`Forward`] and [`ForwardScans`] apply it to frames and scans.

mod frames;
mod scans;

pub use frames::Forward;
pub use scans::ForwardScans;

use geometry::median;
use std::collections::VecDeque;

/// So many stamps after one are asked about it.
pub(crate) const LOOKED_AHEAD: usize = 4;
/// So many stamps that rise among themselves are a clock; fewer are mistakes.
const FEW: usize = 3;
/// A step of so many usual ones needs no second look: sources lose some frames now and then.
const PLAIN_STEPS: f64 = 3.0;
/// The first and the last stamp of a recording have neighbours on one side alone: they are off where they are so many usual steps,
/// and so many seconds, away.
const FAR_STEPS: f64 = 100.0;
const FAR_S: f64 = 1.0;
/// No recording pauses for more than a day between two frames, nor for so many of its usual steps.
const LONGEST_PAUSE_S: f64 = 86_400.0;
const LONGEST_PAUSE_STEPS: f64 = 1000.0;
/// No clock says more, in seconds: thirty thousand years, at which an `f64` has microseconds yet.
const LATEST_S: f64 = 1e12;
/// The usual step is the median of so many.
const RECENT: usize = 9;
/// Seconds of a step where none is known yet: video's.
const USUAL_STEP_S: f64 = 1.0 / 30.0;

/// The verdict on a stamp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StampVerdict {
    /// It is later than all before: seconds on a time that goes forward.
    At(f64),
    /// It is that of the frame before.
    Repeats,
    /// It is off those around it.
    Off,
    /// It is no number.
    NoTime,
}

/// The faults of the stamps so far.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Faults {
    /// Stamps that are off those around them.
    pub off: u64,
    /// Stamps that repeat the one before.
    pub repeated: u64,
    /// Stamps that are no numbers.
    pub none: u64,
    /// How often the clock was set.
    pub sets: u64,
    /// The first time it was: at which stamp, from 0, and by how many seconds; below 0 back.
    pub first_set: Option<(u64, f64)>,
}

impl Faults {
    /// What loopbox did about them, for people; empty where there are none.
    pub fn texts(&self) -> Vec<String> {
        self.of_set().into_iter().chain(self.of_frames()).collect()
    }

    /// The note that the clock was set.
    pub fn of_set(&self) -> Option<String> {
        let (place, by) = self.first_set?;
        let direction = if by < 0.0 { "back" } else { "ahead" };
        let more = match self.sets {
            1 => String::new(),
            sets => format!(", and {} times more", sets - 1),
        };
        Some(format!(
            "the clock was set {direction} by {} s at frame {place}{more}: time goes on from there as if it had not been, so \
             that results have other times than the recording from there on",
            rounded(by.abs())
        ))
    }

    /// Which frames are left out.
    pub fn of_frames(&self) -> Vec<String> {
        let counts = [
            (self.off, "lie off those around them"),
            (self.repeated, "repeat the one before"),
            (self.none, "are no numbers"),
        ];
        let reported = counts.into_iter().filter(|(count, _)| *count > 0);
        reported
            .map(|(count, what)| format!("{count} of the time stamps {what}: these frames are left out"))
            .collect()
    }
}

/// Seconds with as many digits as say something.
fn rounded(seconds: f64) -> String {
    if seconds < 10.0 { format!("{seconds:.3}") } else { format!("{seconds:.1}") }
}

/// The clock of a recording, stamp by stamp.
#[derive(Clone, Debug, Default)]
pub struct Clock {
    /// The last stamp that counted, on the time that goes forward.
    last: Option<f64>,
    /// What is added to stamps since the clock was set.
    offset: f64,
    /// The last steps, seconds.
    steps: VecDeque<f64>,
    seen: u64,
    faults: Faults,
}

impl Clock {
    /// The faults so far.
    pub fn faults(&self) -> &Faults {
        &self.faults
    }

    /// The time of the last frame that counted.
    pub fn last(&self) -> Option<f64> {
        self.last
    }

    /// Whether a stamp follows so closely that those after it need not be known.
    pub fn is_plain(&self, stamp: f64) -> bool {
        let step = self.last.map(|last| stamp + self.offset - last);
        step.zip(self.usual_step()).is_some_and(|(step, usual)| step > 0.0 && step <= PLAIN_STEPS * usual)
    }

    /// Judges the next stamp by those that follow it, four of them where there are as many; of a stamp that
    /// [`Clock::is_plain`] they need not be given. All in seconds.
    pub fn judge(&mut self, stamp: f64, following: &[f64]) -> StampVerdict {
        let place = self.seen;
        self.seen += 1;
        if !stamp.is_finite() {
            self.faults.none += 1;
            return StampVerdict::NoTime;
        }
        if self.is_plain(stamp) {
            return self.advance(stamp + self.offset);
        }
        if stamp.abs() > LATEST_S {
            return self.off();
        }
        let stamp = stamp + self.offset;
        let following: Vec<f64> =
            following.iter().filter(|f| f.abs() <= LATEST_S).map(|f| f + self.offset).collect();
        let Some(last) = self.last else { return self.first(stamp, &following) };
        if stamp == last {
            self.faults.repeated += 1;
            return StampVerdict::Repeats;
        }
        if stamp < last {
            return self.earlier(place, stamp, last, &following);
        }
        let with = 1 + longest_rise(&following, stamp);
        // Where as many speak for it as against it, a step that is far is the wrong one.
        let against = longest_rise(&following, last) + usize::from(self.is_far(stamp - last));
        if against > with || against == with && following.is_empty() {
            return self.off();
        }
        if self.is_too_long(stamp - last) && with >= FEW {
            return self.set(place, stamp, last);
        }
        self.advance(stamp)
    }

    fn first(&mut self, stamp: f64, following: &[f64]) -> StampVerdict {
        let is_above = longest_rise(following, f64::NEG_INFINITY) > 1 + longest_rise(following, stamp);
        let mut steps: Vec<f64> = following.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let usual = median(&mut steps).filter(|usual| *usual > 0.0 && following.len() >= FEW);
        let is_below = usual.is_some_and(|usual| following.iter().all(|next| is_far(next - stamp, usual)));
        if is_above || is_below { self.off() } else { self.advance(stamp) }
    }

    fn earlier(&mut self, place: u64, stamp: f64, last: f64, following: &[f64]) -> StampVerdict {
        let mut top = stamp;
        let rising = following.iter().take_while(|next| {
            let rises = **next > top && **next <= last;
            top = top.max(**next);
            rises
        });
        if 1 + rising.count() >= FEW { self.set(place, stamp, last) } else { self.off() }
    }

    fn off(&mut self) -> StampVerdict {
        self.faults.off += 1;
        StampVerdict::Off
    }

    /// The clock was set: time goes on by a usual step.
    fn set(&mut self, place: u64, stamp: f64, last: f64) -> StampVerdict {
        let step = self.usual_step().unwrap_or(USUAL_STEP_S);
        self.faults.sets += 1;
        self.faults.first_set.get_or_insert((place, stamp - last - step));
        self.offset += last + step - stamp;
        self.advance(last + step)
    }

    fn advance(&mut self, time: f64) -> StampVerdict {
        if let Some(last) = self.last {
            self.steps.truncate(RECENT - 1);
            self.steps.push_front(time - last);
        }
        self.last = Some(time);
        StampVerdict::At(time)
    }

    fn usual_step(&self) -> Option<f64> {
        let mut steps = [0.0; RECENT];
        let steps = &mut steps[..self.steps.len()];
        steps.iter_mut().zip(&self.steps).for_each(|(to, from)| *to = *from);
        median(steps)
    }

    fn is_far(&self, step: f64) -> bool {
        self.usual_step().is_some_and(|usual| is_far(step, usual))
    }

    fn is_too_long(&self, step: f64) -> bool {
        step > LONGEST_PAUSE_S && self.usual_step().is_none_or(|usual| step > LONGEST_PAUSE_STEPS * usual)
    }
}

fn is_far(step: f64, usual: f64) -> bool {
    step > FAR_S && step > FAR_STEPS * usual
}

/// How many of the stamps above `floor` can be kept so that they rise.
fn longest_rise(stamps: &[f64], floor: f64) -> usize {
    let mut best = [0; LOOKED_AHEAD];
    let stamps = &stamps[..stamps.len().min(LOOKED_AHEAD)];
    for (i, stamp) in stamps.iter().enumerate().filter(|(_, stamp)| **stamp > floor) {
        let before = (0..i).filter(|&j| stamps[j] > floor && stamps[j] < *stamp).map(|j| best[j]).max();
        best[i] = 1 + before.unwrap_or(0);
    }
    best.into_iter().max().unwrap_or(0)
}

/// Judges a whole list of stamps.
pub fn check_stamps(stamps: &[f64]) -> (Vec<StampVerdict>, Faults) {
    let mut clock = Clock::default();
    let ahead = |i: usize| &stamps[i + 1..(i + 1 + LOOKED_AHEAD).min(stamps.len())];
    let of_each = stamps.iter().enumerate().map(|(i, stamp)| clock.judge(*stamp, ahead(i))).collect();
    (of_each, clock.faults)
}

#[cfg(test)]
mod tests;
