//! What is seen of a recording's frames before it is run.

use geometry::median;
use sources::FrameSource;
use sources::pictures::Picture;

/// Frames are looked through until they hold so many bytes together: about ten seconds of reading.
const MOST_BYTES: u64 = 4 << 30;
/// A step from frame to frame is a gap when it is so many usual ones long, and so many seconds.
const GAP: (f64, f64) = (5.0, 0.5);

/// What was seen of frames.
#[derive(Debug, Default)]
pub struct FrameSurvey {
    /// Width and height of the first image that can be read, pixels.
    pub size: Option<(usize, usize)>,
    /// Frames that were looked at.
    looked_at: u64,
    /// Those that hold no image of the recording, and why the first does not.
    unusable: u64,
    reason: Option<String>,
    /// Whether that were all of them.
    all: bool,
    stamps: Vec<f64>,
}

impl FrameSurvey {
    /// Takes frames from `source`, until an image can be read, and where others need not be decoded for it these as well.
    pub fn of(source: &mut dyn FrameSource) -> Self {
        let (mut seen, mut bytes) = (Self::default(), 0);
        loop {
            if bytes > MOST_BYTES || seen.size.is_some() && source.decodes() {
                return seen;
            }
            let Some(frame) = source.next_frame() else { break };
            bytes += frame.picture.memory_bytes();
            if matches!(frame.picture, Picture::Mistimed(_)) {
                // What is wrong with times the source says.
                seen.looked_at += 1;
                continue;
            }
            seen.stamps.push(frame.timestamp);
            seen.look_at(frame.picture);
        }
        seen.all = true;
        seen
    }

    fn look_at(&mut self, picture: Picture) {
        self.looked_at += 1;
        let found = match self.size {
            None => picture.into_grey().map(|image| self.size = Some((image.width(), image.height()))),
            Some(_) => picture.trouble().map_or(Ok(()), Err),
        };
        if let Err(reason) = found {
            self.unusable += 1;
            self.reason.get_or_insert(reason);
        }
    }

    /// What is wrong with the frames.
    pub fn problem(&self) -> Option<String> {
        let reason = self.reason.as_ref()?.replace("\nhint: ", "; ");
        Some(format!("{} of {} images cannot be used; the first: {reason}", self.unusable, self.looked_at))
    }

    /// Why no run can be made of them.
    pub fn refused(&self) -> Option<String> {
        match &self.reason {
            _ if self.unusable < self.looked_at || !self.all => None,
            Some(reason) => Some(format!("no image can be read: {reason}")),
            None => Some("there is no image".into()),
        }
    }

    /// How the frames follow each other, as label and text.
    pub fn facts(&self) -> Vec<(&'static str, String)> {
        let steps: Vec<f64> = self.stamps.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let usual = median(&mut steps.clone()).unwrap_or(0.0);
        let is_gap = |step: &f64| *step > GAP.1.max(GAP.0 * usual);
        let longest = steps.iter().copied().enumerate().filter(|(_, step)| is_gap(step));
        let longest = longest.max_by(|a, b| a.1.total_cmp(&b.1));
        let gaps = longest.map(|(index, step)| {
            let count = steps.iter().filter(|step| is_gap(step)).count();
            let after = self.stamps[index] - self.stamps[0];
            let many = if count == 1 { "one" } else { &*format!("{count}, the longest") };
            ("gaps", format!("{many} of {step:.2} s after {after:.2} s"))
        });
        let part = (!self.all && self.looked_at > 1)
            .then(|| ("looked at", format!("the first {} frames", self.looked_at)));
        gaps.into_iter().chain(part).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(stamps: &[f64]) -> FrameSurvey {
        FrameSurvey {
            stamps: stamps.to_vec(),
            looked_at: stamps.len() as u64,
            all: true,
            ..FrameSurvey::default()
        }
    }

    #[test]
    fn gaps_are_reported_and_usual_steps_are_not() {
        assert!(seen(&[0.0, 0.1, 0.2, 0.35]).facts().is_empty());
        // A slow camera has long steps.
        assert!(seen(&[0.0, 2.0, 4.0, 6.5]).facts().is_empty());
        let one = seen(&[0.0, 0.1, 0.2, 7.2, 7.3]).facts();
        assert!(one[0].1.starts_with("one of 7.00 s after 0.20 s"), "{one:?}");
        let two = seen(&[0.0, 0.1, 1.2, 1.3, 1.4, 1.5, 9.5]).facts();
        assert!(two[0].1.starts_with("2, the longest of 8.00 s after 1.50 s"), "{two:?}");
    }

    #[test]
    fn a_recording_is_refused_only_where_nothing_of_it_can_be_used() {
        let counted = |looked_at, unusable, all| FrameSurvey {
            looked_at,
            unusable,
            all,
            reason: (unusable > 0).then(|| "torn".into()),
            ..FrameSurvey::default()
        };
        assert_eq!(counted(9, 9, true).refused().as_deref(), Some("no image can be read: torn"));
        assert_eq!(counted(0, 0, true).refused().as_deref(), Some("there is no image"));
        for usable in [counted(9, 8, true), counted(9, 9, false), counted(9, 0, true)] {
            assert_eq!(usable.refused(), None, "{usable:?}");
        }
        assert_eq!(
            counted(9, 2, true).problem().as_deref(),
            Some("2 of 9 images cannot be used; the first: torn")
        );
    }
}
