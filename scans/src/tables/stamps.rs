//! Time stamps in text: numbers of a unit that is told from their steps, and dates.

use std::path::PathBuf;

/// Steps of sequences are this far, as a logarithm to base *e*, from a video's thirty a second at most where nothing else is known: it
/// takes as many to outweigh what is.
const USUAL_RATE: f64 = 30.0;
/// What a header that names the unit weighs, stamps that are of our days, and numbers with a fraction, which are seconds mostly.
const NAMED: f64 = 12.0;
const OF_OUR_DAYS: f64 = 7.0;
const FRACTIONS: f64 = 3.0;
/// What it weighs that seconds are the usual unit.
const SECONDS: f64 = 2.0;
/// Our days, seconds since 1970: from 2000 on, as far as recordings can hold.
pub(super) const OUR_DAYS: std::ops::Range<f64> = 9.4e8..4.3e9;

/// What a number of a table counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// Seconds.
    Seconds,
    /// Thousandths of them.
    Milliseconds,
    /// Millionths.
    Microseconds,
    /// Thousand millionths.
    Nanoseconds,
}

impl Unit {
    pub(super) const ALL: [Self; 4] =
        [Self::Seconds, Self::Milliseconds, Self::Microseconds, Self::Nanoseconds];

    /// How many of them are a second.
    pub fn per_second(self) -> u64 {
        match self {
            Self::Seconds => 1,
            Self::Milliseconds => 1_000,
            Self::Microseconds => 1_000_000,
            Self::Nanoseconds => 1_000_000_000,
        }
    }

    /// Its name, for people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Seconds => "seconds",
            Self::Milliseconds => "milliseconds",
            Self::Microseconds => "microseconds",
            Self::Nanoseconds => "nanoseconds",
        }
    }

    /// The unit that a header names: `timestamp [ns]`, `time_us`, `t(ms)`, `nanoseconds`.
    fn named(header: &str) -> Option<Self> {
        let header = header.to_lowercase();
        let mut words = header.split(|c: char| !c.is_alphanumeric() && c != 'µ');
        words.find_map(|word| match word {
            "ns" | "nsec" | "nsecs" | "nanosec" | "nanosecs" | "nanosecond" | "nanoseconds" => {
                Some(Self::Nanoseconds)
            }
            "us" | "µs" | "usec" | "usecs" | "microsecond" | "microseconds" => Some(Self::Microseconds),
            "ms" | "msec" | "msecs" | "millisecond" | "milliseconds" => Some(Self::Milliseconds),
            "s" | "sec" | "secs" | "second" | "seconds" => Some(Self::Seconds),
            _ => None,
        })
    }

    /// The unit of numbers by their steps and size.
    pub(super) fn infer(values: &[f64], fractions: bool, header: &str) -> Self {
        let mut steps: Vec<f64> =
            values.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 0.0).collect();
        steps.sort_by(f64::total_cmp);
        let (step, first) = (steps.get(steps.len() / 2).copied(), values.first().copied().unwrap_or(0.0));
        let named = Self::named(header);
        let weight = |unit: Self| {
            let per_second = unit.per_second() as f64;
            let far = step.map_or(0.0, |step| (step / per_second * USUAL_RATE).ln().abs());
            let of = |is: bool, weight: f64| if is { weight } else { 0.0 };
            of(named == Some(unit), NAMED)
                + of(OUR_DAYS.contains(&(first / per_second)), OF_OUR_DAYS)
                + of(unit == Self::Seconds, SECONDS)
                + of(unit == Self::Seconds && fractions, FRACTIONS)
                - far
        };
        let best = Self::ALL.into_iter().max_by(|a, b| weight(*a).total_cmp(&weight(*b)));
        best.unwrap_or(Self::Seconds)
    }
}

/// Time stamps in seconds, and what they were read from.
#[derive(Clone, Debug, PartialEq)]
pub struct Stamps {
    /// Seconds, since 1970 or since whatever the table counts from.
    pub seconds: Vec<f64>,
    /// The unit they are written in; `None` of dates.
    pub unit: Option<Unit>,
}

impl Stamps {
    /// Reads stamps; `header` may say their unit.
    ///
    /// # Errors
    /// The index of the first that is none.
    pub fn parse<'a>(texts: impl Iterator<Item = &'a str>, header: &str) -> Result<Self, usize> {
        let texts: Vec<&str> = texts.collect();
        if let Some(seconds) = with_counted_nanoseconds(&texts) {
            return Ok(Self { seconds, unit: Some(Unit::Seconds) });
        }
        let numbers = texts.iter().enumerate().map(|(i, text)| Number::parse(text).ok_or(i));
        let numbers: Vec<Number> = numbers.collect::<Result<_, _>>()?;
        if numbers.iter().any(|number| matches!(number, Number::Moment(_))) {
            let moments = numbers.iter().map(|number| match number {
                Number::Moment(nanoseconds) => Some(seconds(*nanoseconds)),
                _ => None,
            });
            let moments: Vec<Option<f64>> = moments.collect();
            let other = moments.iter().position(Option::is_none);
            return match other {
                Some(other) => Err(other),
                None => Ok(Self { seconds: moments.into_iter().flatten().collect(), unit: None }),
            };
        }
        let values: Vec<f64> = numbers.iter().map(Number::value).collect();
        let fractions = numbers.iter().any(|number| matches!(number, Number::Fraction(_)));
        let unit = Unit::infer(&values, fractions, header);
        Ok(Self { seconds: numbers.iter().map(|number| number.seconds(unit)).collect(), unit: Some(unit) })
    }

    /// What unit was told, where that is not seconds, for people.
    pub fn remark(&self) -> Option<String> {
        let unit = self.unit.filter(|unit| *unit != Unit::Seconds)?;
        let rate = usual_step(&self.seconds).filter(|step| *step > 0.0);
        let rate = rate.map_or(String::new(), |step| format!(": {:.4} a second", 1.0 / step));
        Some(format!("in {}, by their steps{rate}", unit.name()))
    }
}

/// Seconds and nanoseconds of ROS that were written one behind the other with a point between and without zeros before, so that 0.067 s is
/// `0.66666999`: told where these are more even than decimals.
fn with_counted_nanoseconds(texts: &[&str]) -> Option<Vec<f64>> {
    /// Fewest stamps of which that is told.
    const LEAST: usize = 8;
    let digits = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    let parts = texts.iter().map(|text| {
        let (whole, part) = text.split_once('.').filter(|(whole, part)| digits(whole) && digits(part))?;
        let whole: u64 = whole.parse().ok().filter(|whole| OUR_DAYS.contains(&(*whole as f64)))?;
        (part.len() <= 9).then_some((whole, part))
    });
    let parts: Vec<(u64, &str)> = parts.collect::<Option<_>>()?;
    let is_full = |(_, part): &(u64, &str)| part.len() == 9;
    if parts.len() < LEAST || parts.iter().all(is_full) || !parts.iter().any(is_full) {
        return None;
    }
    let counted =
        parts.iter().map(|(whole, part)| Some(seconds(whole * NS_PER_S + part.parse::<u64>().ok()?)));
    let counted: Vec<f64> = counted.collect::<Option<_>>()?;
    let decimal: Vec<f64> = texts.iter().map(|text| text.parse().ok()).collect::<Option<_>>()?;
    (unevenness(&counted) < 0.5 * unevenness(&decimal)).then_some(counted)
}

/// The median of the steps from value to value; of two in the middle the greater.
fn usual_step(values: &[f64]) -> Option<f64> {
    let mut steps: Vec<f64> = values.windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() / 2).copied()
}

/// How far steps between times, in their order, are from the usual one, all together.
fn unevenness(times: &[f64]) -> f64 {
    let mut times = times.to_vec();
    times.sort_by(f64::total_cmp);
    let usual = usual_step(&times).unwrap_or(0.0);
    times.windows(2).map(|pair| (pair[1] - pair[0] - usual).abs()).sum()
}

/// Digits of a whole number of seconds since 1970; with those of milliseconds, microseconds and nanoseconds behind.
const DIGITS_SINCE_1970: [usize; 4] = [10, 13, 16, 19];

/// The stamps that the names of files are, as `1403636579763555584.png` and `1305031102.175304.bin`; `None` where they are numbers.
pub fn stamps_of_names(files: &[PathBuf]) -> Option<Stamps> {
    let stem = |file: &PathBuf| Some(file.file_stem()?.to_string_lossy().into_owned());
    let stems: Vec<String> = files.iter().map(stem).collect::<Option<_>>()?;
    // What all names share before a stamp says nothing of it: `frame_1403636579763555584`.
    let digits = |stem: &String| stem.find(|c: char| c.is_ascii_digit());
    let start = stems.first().and_then(digits)?;
    let prefix = stems[0][..start].to_owned();
    let names: Vec<&str> = stems.iter().map(|stem| stem.strip_prefix(&*prefix)).collect::<Option<_>>()?;
    let is_stamp = |name: &&str| {
        let (whole, part) = name.split_once('.').unwrap_or((name, ""));
        let are_digits = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
        let counts_seconds = !part.is_empty() && part.len() >= 2;
        moment(name).is_some()
            || are_digits(whole)
                && are_digits(part)
                && !whole.is_empty()
                && (counts_seconds || DIGITS_SINCE_1970.contains(&whole.len()) && !whole.starts_with('0'))
    };
    if !names.iter().all(is_stamp) {
        return None;
    }
    let stamps = Stamps::parse(names.iter().copied(), "").ok()?;
    // A counter of ten digits steps by one.
    let values: Vec<f64> = names.iter().filter_map(|name| name.parse().ok()).collect();
    let is_counter = usual_step(&values) == Some(1.0) && !names[0].contains('.');
    (!is_counter).then_some(stamps)
}

/// A stamp as it is written.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Number {
    Whole(i128),
    Fraction(f64),
    /// Nanoseconds since 1970.
    Moment(u64),
}

impl Number {
    fn parse(text: &str) -> Option<Self> {
        let digits = text.strip_prefix(['-', '+']).unwrap_or(text);
        if digits.len() < 30 && !digits.is_empty() && digits.bytes().all(|byte| byte.is_ascii_digit()) {
            return text.parse().ok().map(Self::Whole);
        }
        let value = text.parse::<f64>().ok().filter(|value| value.is_finite());
        value.map(Self::Fraction).or_else(|| moment(text).map(Self::Moment))
    }

    fn value(&self) -> f64 {
        match *self {
            Self::Whole(number) => number as f64,
            Self::Fraction(number) => number,
            Self::Moment(nanoseconds) => nanoseconds as f64,
        }
    }

    fn seconds(&self, unit: Unit) -> f64 {
        let per_second = unit.per_second();
        match *self {
            Self::Whole(number) => {
                let nanoseconds =
                    u64::try_from(number).ok().and_then(|n| n.checked_mul(1_000_000_000 / per_second));
                nanoseconds.map_or(number as f64 / per_second as f64, seconds)
            }
            Self::Fraction(number) => number / per_second as f64,
            Self::Moment(nanoseconds) => seconds(nanoseconds),
        }
    }
}

/// Whether a text is a time.
pub(super) fn is_time(text: &str) -> bool {
    Number::parse(text).is_some()
}

/// Up to here every whole number is an `f64`.
const EXACT: u64 = 1 << 53;
const NS_PER_S: u64 = 1_000_000_000;

/// Seconds of a number of nanoseconds: the nearest `f64`, up to 104 days; beyond, whole seconds are split
/// off first, which is as good at that size.
pub fn seconds(nanoseconds: u64) -> f64 {
    if nanoseconds < EXACT {
        return nanoseconds as f64 / NS_PER_S as f64;
    }
    (nanoseconds / NS_PER_S) as f64 + (nanoseconds % NS_PER_S) as f64 / NS_PER_S as f64
}

/// The nanoseconds since 1970 of a date and time such as `2011-09-26 13:02:25.594360375`, `2024/05/01T10:00:00Z` or `2024_05_01_10_00_00_123`,
/// all in universal time; `None` where it is none.
pub fn moment(text: &str) -> Option<u64> {
    let text = text.trim().trim_end_matches(['Z', 'z']);
    let mut parts = text.split(|c: char| !c.is_ascii_digit());
    let mut next = |lengths: std::ops::RangeInclusive<usize>| {
        let part = parts.next().filter(|part| lengths.contains(&part.len()))?;
        Some((part.parse::<u64>().ok()?, part.len() as u32))
    };
    let (year, _) = next(4..=4)?;
    let ((month, _), (day, _)) = (next(1..=2)?, next(1..=2)?);
    let ((hour, _), (minute, _), (second, _)) = (next(1..=2)?, next(1..=2)?, next(1..=2)?);
    let (fraction, digits) = next(1..=9).unwrap_or((0, 9));
    let is_date = (1970..2106).contains(&year) && (1..=12).contains(&month) && (1..=31).contains(&day);
    if !is_date || hour > 23 || minute > 59 || second > 60 || parts.next().is_some() {
        return None;
    }
    let whole = days(year, month, day) * 86_400 + hour * 3600 + minute * 60 + second;
    Some(whole * NS_PER_S + fraction * 10u64.pow(9 - digits))
}

/// Days from 1970-01-01 to a date of the Gregorian calendar.
fn days(year: u64, month: u64, day: u64) -> u64 {
    // Years begin in March here, so that a leap day is their last.
    let (year, month) = if month > 2 { (year, month - 3) } else { (year - 1, month + 9) };
    let of_years = year * 365 + year / 4 - year / 100 + year / 400;
    of_years + (153 * month + 2) / 5 + day - 1 - 719_468
}
