//! Which of a camera's formats, sizes and rates to take.

use std::fmt;
use std::str::FromStr;

/// The size of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Size {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl Size {
    /// The default size: enough for a direct method, and every camera has it or a similar one.
    pub const USUAL: Self = Self { width: 640, height: 480 };

    fn pixels(self) -> u64 {
        self.width as u64 * self.height as u64
    }
}

impl fmt::Display for Size {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once(['x', 'X', '×']);
        let parsed = parts.and_then(|(w, h)| Some((w.trim().parse().ok()?, h.trim().parse().ok()?)));
        match parsed {
            Some((width, height)) if (1..=1 << 15).contains(&width) && (1..=1 << 15).contains(&height) => {
                Ok(Self { width, height })
            }
            _ => Err("give WIDTHxHEIGHT in pixels, such as 640x480".into()),
        }
    }
}

/// A pixel format that loopbox reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelFormat {
    /// 8-bit grey.
    Grey,
    /// 8-bit grey, then chroma at half the size.
    Nv12,
    /// Grey in every other byte, the first.
    Yuyv,
    /// Grey in every other byte, the second.
    Uyvy,
    /// 16-bit grey, little end first, with the range of the first images. V4L2 has other formats (`Y10`, `Y12`) for
    /// sensors that fill fewer bits from below.
    Y16,
    /// A JPEG file for each frame.
    Mjpg,
}

impl PixelFormat {
    /// The cheapest way to a grey image first; the compressed one last, it also loses detail.
    pub const ALL: [Self; 6] = [Self::Grey, Self::Nv12, Self::Yuyv, Self::Uyvy, Self::Y16, Self::Mjpg];

    /// V4L2's code of four characters.
    pub fn code(self) -> [u8; 4] {
        *match self {
            Self::Grey => b"GREY",
            Self::Nv12 => b"NV12",
            Self::Yuyv => b"YUYV",
            Self::Uyvy => b"UYVY",
            Self::Y16 => b"Y16 ",
            Self::Mjpg => b"MJPG",
        }
    }

    /// The format of a code, if loopbox reads it.
    pub fn of_code(code: [u8; 4]) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.code() == code)
    }

    /// The code as people write it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Grey => "GREY",
            Self::Nv12 => "NV12",
            Self::Yuyv => "YUYV",
            Self::Uyvy => "UYVY",
            Self::Y16 => "Y16",
            Self::Mjpg => "MJPG",
        }
    }
}

/// Frame rates, per second.
#[derive(Clone, Debug, PartialEq)]
pub enum Rates {
    /// These.
    List(Vec<f64>),
    /// Any from the first to the second.
    Range(f64, f64),
    /// The driver does not say.
    Unknown,
}

impl Rates {
    /// The rate nearest to the wanted one; `None` when the driver does not say.
    fn nearest(&self, wanted: f64) -> Option<f64> {
        match self {
            Self::List(rates) => {
                rates.iter().copied().min_by(|a, b| (a - wanted).abs().total_cmp(&(b - wanted).abs()))
            }
            Self::Range(low, high) => Some(wanted.max(*low).min(*high)),
            Self::Unknown => None,
        }
    }
}

impl fmt::Display for Rates {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::List(rates) => {
                let rates: Vec<String> = rates.iter().map(|&rate| rate_text(rate)).collect();
                write!(f, "{}", rates.join(", "))
            }
            Self::Range(low, high) => write!(f, "{} to {}", rate_text(*low), rate_text(*high)),
            Self::Unknown => write!(f, "?"),
        }
    }
}

/// A rate without needless digits: `30`, `29.97`.
pub fn rate_text(rate: f64) -> String {
    let rounded = (rate * 100.0).round() / 100.0;
    rounded.to_string()
}

/// The sizes that a format comes in.
#[derive(Clone, Debug, PartialEq)]
pub enum Sizes {
    /// These, with their rates.
    List(Vec<(Size, Rates)>),
    /// Any from the smallest to the largest, in steps, with the rates of the largest.
    Range {
        /// The smallest.
        min: Size,
        /// The largest.
        max: Size,
        /// Steps of width and height from the smallest on.
        step: (u32, u32),
        /// The rates of the largest.
        rates: Rates,
    },
    /// The driver does not say; this is what it is set to.
    Present(Size),
}

impl fmt::Display for Sizes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::List(sizes) => {
                let sizes: Vec<String> =
                    sizes.iter().map(|(size, rates)| format!("{size} at {rates}")).collect();
                write!(f, "{}", sizes.join("; "))
            }
            Self::Range { min, max, rates, .. } => write!(f, "{min} to {max} at {rates}"),
            Self::Present(size) => write!(f, "{size}"),
        }
    }
}

/// One pixel format of a camera, with its sizes and rates.
#[derive(Clone, Debug, PartialEq)]
pub struct FormatSizes {
    /// The format.
    pub format: PixelFormat,
    /// Its sizes.
    pub sizes: Sizes,
}

/// The format that the user requests.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FormatRequest {
    /// This format.
    pub format: Option<PixelFormat>,
    /// This size.
    pub size: Option<Size>,
    /// This rate, frames per second.
    pub fps: Option<f64>,
}

/// The default frame rate, frames per second.
pub const USUAL_RATE: f64 = 30.0;

/// The chosen format.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    /// The format.
    pub format: PixelFormat,
    /// The size.
    pub size: Size,
    /// The rate, frames per second; `None` when the driver does not say which it has.
    pub rate: Option<f64>,
}

/// Chooses among `formats` the requested size, or the one nearest to 640×480. Of the formats that reach the requested
/// rate at that size it takes the one that is cheapest to convert. `None` when there is no such format or size.
pub fn choose(formats: &[FormatSizes], request: &FormatRequest) -> Option<Choice> {
    let fps = request.fps.unwrap_or(USUAL_RATE);
    let mut choices: Vec<Choice> = formats
        .iter()
        .filter(|available| request.format.is_none_or(|format| format == available.format))
        .flat_map(|available| choices_of(available, request.size, fps))
        .collect();
    if request.size.is_none() {
        let away = |size: Size| size.pixels().abs_diff(Size::USUAL.pixels());
        let nearest = choices.iter().map(|choice| choice.size).min_by_key(|&size| (away(size), size))?;
        choices.retain(|choice| choice.size == nearest);
    }
    // Where the driver does not say, the rate may well be reached.
    let reached = |choice: &Choice| choice.rate.is_none_or(|rate| rate > 0.95 * fps);
    let rank = |choice: &Choice| PixelFormat::ALL.iter().position(|&format| format == choice.format);
    if choices.iter().any(reached) {
        choices.retain(reached);
        choices.into_iter().min_by_key(rank)
    } else {
        let fastest = choices.iter().filter_map(|choice| choice.rate).fold(0.0, f64::max);
        choices.into_iter().filter(|choice| choice.rate == Some(fastest)).min_by_key(rank)
    }
}

/// What a format has of the wanted size, or of all sizes.
fn choices_of(available: &FormatSizes, wanted: Option<Size>, fps: f64) -> Vec<Choice> {
    let choice = |size, rates: &Rates| Choice { format: available.format, size, rate: rates.nearest(fps) };
    match &available.sizes {
        Sizes::List(sizes) => sizes
            .iter()
            .filter(|(size, _)| wanted.is_none_or(|wanted| wanted == *size))
            .map(|(size, rates)| choice(*size, rates))
            .collect(),
        Sizes::Range { min, max, step, rates } => {
            let target = wanted.unwrap_or(Size::USUAL);
            let size = Size {
                width: fit(target.width, min.width, max.width, step.0),
                height: fit(target.height, min.height, max.height, step.1),
            };
            let fits = wanted.is_none_or(|wanted| wanted == size);
            if fits { vec![choice(size, rates)] } else { vec![] }
        }
        // Whether it takes another size, only setting it tells.
        Sizes::Present(size) => vec![choice(wanted.unwrap_or(*size), &Rates::Unknown)],
    }
}

/// The number of the form `min + i · step` up to `max` that is next below `value`.
fn fit(value: u32, min: u32, max: u32, step: u32) -> u32 {
    let value = value.clamp(min, max.max(min));
    value - (value - min) % step.max(1)
}

#[cfg(test)]
#[path = "format_tests.rs"]
mod tests;
