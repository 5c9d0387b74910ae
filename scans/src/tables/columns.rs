//! Which columns of a table are the times.

use super::stamps::{OUR_DAYS, is_time, seconds};
use super::{Stamps, Table, Unit};

/// Words by which headers call a column of times.
const TIME_WORDS: [&str; 10] =
    ["time", "timestamp", "timestamps", "stamp", "t", "seconds", "sec", "secs", "s", "time_s"];
/// Words by which they call the seconds of a time that two columns are, and the parts of a second.
const SECONDS: [&str; 4] = ["sec", "secs", "seconds", "tv_sec"];
const PARTS: [(&str, u64); 8] = [
    ("nsec", 1),
    ("nsecs", 1),
    ("nanosec", 1),
    ("nanoseconds", 1),
    ("tv_nsec", 1),
    ("usec", 1000),
    ("tv_usec", 1000),
    ("microseconds", 1000),
];
/// Nanoseconds in a second.
const NS_PER_S: u64 = 1_000_000_000;

/// Where the times of a table stand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Times {
    /// In one column.
    Column(usize),
    /// Whole seconds in one column, and in the next what is to be added in units of so many nanoseconds.
    Parts(usize, u64),
}

impl Table {
    /// Where the times are, if the column `name` says whose they are: what the header calls so; else whole seconds and their parts;
    /// else of the columns of times those that rise, and of these none that counts by one, the nearest before the name, or behind it.
    pub fn times_of(&self, name: Option<usize>) -> Option<Times> {
        let width = self.rows.first()?.fields.len();
        let columns: Vec<usize> = (0..width).filter(|column| Some(*column) != name).collect();
        let parts = columns.iter().find_map(|column| self.parts(*column));
        if parts.is_some() {
            return parts;
        }
        let of_times = columns.into_iter().filter(|column| self.rows.iter().all(|row| row.is_time(*column)));
        let all: Vec<usize> = of_times.collect();
        let called = |column: &&usize| {
            self.names.get(**column).is_some_and(|name| TIME_WORDS.contains(&without_unit(name)))
        };
        if let Some(column) = all.iter().find(called) {
            return Some(Times::Column(*column));
        }
        let rising: Vec<usize> =
            all.iter().copied().filter(|column| self.is_increasing(Times::Column(*column))).collect();
        let rising = if rising.is_empty() { all } else { rising };
        let clocks: Vec<usize> = rising.iter().copied().filter(|column| !self.counts(*column)).collect();
        let best = if clocks.is_empty() { rising } else { clocks };
        let before = best.iter().rev().find(|column| name.is_none_or(|name| **column < name));
        before.or(best.first()).copied().map(Times::Column)
    }

    /// The times there, in seconds.
    ///
    /// # Errors
    /// The first row without a time there.
    pub fn stamps_at(&self, times: Times) -> Result<Stamps, &super::Row> {
        let (column, unit) = match times {
            Times::Column(column) => return self.stamps_of(column),
            Times::Parts(column, unit) => (column, unit),
        };
        let whole = self.rows.iter().map(|row| {
            let (whole, part) = (row.whole(column).ok_or(row)?, row.whole(column + 1).ok_or(row)?);
            let total = whole.checked_mul(NS_PER_S).and_then(|ns| ns.checked_add(part.checked_mul(unit)?));
            total.map(seconds).ok_or(row)
        });
        Ok(Stamps { seconds: whole.collect::<Result<_, _>>()?, unit: Some(Unit::Seconds) })
    }

    /// Whether a column and the next one are whole seconds and what of a second is to be added to them: their names say so, or the first are
    /// seconds since 1970 and the second come anew with each of them.
    fn parts(&self, column: usize) -> Option<Times> {
        /// Fewest rows in which nanoseconds would be seen to be more than microseconds are.
        const LEAST: usize = 4;
        let pairs = self.rows.iter().map(|row| Some((row.whole(column)?, row.whole(column + 1)?)));
        let pairs: Vec<(u64, u64)> = pairs.collect::<Option<_>>()?;
        let most = pairs.iter().map(|(_, part)| *part).max()?;
        let called = |column: usize| self.names.get(column).map_or("", |name| without_unit(name));
        let named = PARTS.iter().find(|(word, _)| called(column + 1) == *word).map(|(_, unit)| *unit);
        let unit = match named.filter(|_| SECONDS.contains(&called(column))) {
            Some(unit) => unit,
            None if pairs.len() < LEAST || most < 1000 => return None,
            None if pairs.iter().any(|(whole, _)| !OUR_DAYS.contains(&(*whole as f64))) => return None,
            None if most < 1_000_000 => 1000,
            None => 1,
        };
        let rises = pairs.windows(2).filter(|pair| pair[0] < pair[1]).count() * 10 >= (pairs.len() - 1) * 9;
        (most < NS_PER_S / unit && (rises || named.is_some())).then_some(Times::Parts(column, unit))
    }

    /// Whether most of the times there are later than those of the rows before.
    pub fn is_increasing(&self, times: Times) -> bool {
        let Ok(stamps) = self.stamps_at(times) else { return false };
        let steps = stamps.seconds.windows(2).filter(|pair| pair[0] < pair[1]).count();
        steps * 10 >= self.rows.len().saturating_sub(1) * 9
    }

    /// Whether a column counts the rows.
    fn counts(&self, column: usize) -> bool {
        let numbers = self.rows.iter().map(|row| row.whole(column));
        let Some(numbers) = numbers.collect::<Option<Vec<u64>>>() else { return false };
        numbers.windows(2).all(|pair| pair[1].checked_sub(pair[0]) == Some(1))
    }
}

impl super::Row {
    /// Whether a time stands there.
    pub fn is_time(&self, column: usize) -> bool {
        self.fields.get(column).is_some_and(|field| is_time(field))
    }

    /// The whole number of a column, if it is one.
    fn whole(&self, column: usize) -> Option<u64> {
        let field = self.fields.get(column)?;
        field.bytes().all(|byte| byte.is_ascii_digit()).then(|| field.parse().ok())?
    }
}

/// A column's name without the unit in brackets, and without `#`.
fn without_unit(name: &str) -> &str {
    let name = name.trim_start_matches('#').trim();
    name.split(['[', '(']).next().unwrap_or(name).trim()
}
