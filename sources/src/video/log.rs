//! The frames in `ffmpeg`'s log: its filter `showinfo` prints a line for each.

use super::probe::fraction;
use crate::ffmpeg::reason;

/// A line of the log that matters.
#[derive(Clone, Debug, PartialEq)]
pub enum Line {
    /// Seconds of a tick of the frames' time stamps, as numerator and denominator.
    TimeBase((i64, i64)),
    /// A frame that follows.
    Frame(LoggedFrame),
    /// Something is wrong with the file.
    Trouble(String),
}

/// A frame as its line describes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LoggedFrame {
    /// Its time stamp in ticks, where it has one.
    pub ticks: Option<i64>,
    /// Width and height, pixels.
    pub size: (usize, usize),
}

impl Line {
    /// Reads a line; `None` for those that do not matter.
    pub fn of(line: &str) -> Option<Self> {
        let (marks, text) = marks(line);
        if marks.iter().any(|mark| ["error", "fatal", "panic"].contains(mark)) {
            return Some(Self::Trouble(reason(line)));
        }
        // Where another thread wrote a line by halves before, it has no marks.
        if !marks.first().is_none_or(|writer| writer.starts_with("Parsed_showinfo")) {
            return None;
        }
        if let Some(config) = text.strip_prefix("config in time_base:") {
            return fraction(config.split(',').next()?).map(Self::TimeBase);
        }
        let fields = text.strip_prefix("n:")?;
        let ticks = word(fields, " pts:")?;
        let (width, height) = word(fields, " s:")?.split_once('x')?;
        let size = (width.parse().ok()?, height.parse().ok()?);
        Some(Self::Frame(LoggedFrame { ticks: ticks.parse().ok(), size }))
    }
}

/// What stands in brackets before a line's text, who writes it and how much it matters, and the text. Only there: names of files
/// may hold anything.
fn marks(line: &str) -> (Vec<&str>, &str) {
    let (mut marks, mut text) = (Vec::new(), line.trim_start());
    while let Some((mark, rest)) = text.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
        marks.push(mark);
        text = rest.trim_start();
    }
    (marks, text)
}

/// The word behind a key, which may be set off by spaces: `pts:     12`.
fn word<'a>(text: &'a str, key: &str) -> Option<&'a str> {
    let (_, rest) = text.split_once(key)?;
    rest.split_whitespace().next()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_several_versions_are_read() {
        let config = "[Parsed_showinfo_1 @ 0x55d] [info] config in time_base: 1/15360, frame_rate: 30/1";
        assert_eq!(Line::of(config), Some(Line::TimeBase((1, 15360))));
        let frame = |line: &str| match Line::of(line) {
            Some(Line::Frame(fields)) => (fields.ticks, fields.size),
            other => panic!("{other:?}"),
        };
        let old = "[Parsed_showinfo_1 @ 0x55d] [info] n:   7 pts:   3584 pts_time:0.233333 pos:    48017 fmt:bgr24 \
                   sar:1/1 s:640x480 i:P iskey:0 type:P ";
        assert_eq!(frame(old), (Some(3584), (640, 480)));
        let new = "[Parsed_showinfo_1 @ 0x55d] [info] n:   0 pts:     -2 pts_time:-0.0001 duration:    512 \
                   duration_time:0.0333333 fmt:gray cl:left sar:0/1 s:96x64 i:P iskey:1 type:I checksum:0";
        assert_eq!(frame(new), (Some(-2), (96, 64)));
        assert_eq!(frame(&new.replace("pts:     -2", "pts:  NOPTS")), (None, (96, 64)));
    }

    #[test]
    fn troubles_are_distinguished_from_the_rest() {
        let trouble = "[h264 @ 0x1] [error] error while decoding MB 1 2";
        assert_eq!(Line::of(trouble), Some(Line::Trouble("error while decoding MB 1 2".into())));
        for line in ["[swscaler @ 0x1] [warning] deprecated pixel format", "Input #0, avi, from 'x':", ""] {
            assert_eq!(Line::of(line), None);
        }
        assert_eq!(Line::of("[Parsed_showinfo_1 @ 0x1] [info]   side data - Display Matrix"), None);
        // A file may be called and titled as it likes.
        for line in
            ["[info] Input #0, avi, from 'file:[error].avi':", "[info]     title   : n: 1 pts: 2 s:3x4"]
        {
            assert_eq!(Line::of(line), None);
        }
        assert!(matches!(Line::of("n:   3 pts:     12 fmt:gray s:96x64"), Some(Line::Frame(_))));
    }
}
