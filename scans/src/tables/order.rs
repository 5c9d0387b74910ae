//! Names in the order in which people count.

use std::path::Path;

/// A name as alternating text and numbers, so that numbers compare by value.
pub fn natural_key(name: &str) -> Vec<(String, u64, String)> {
    let mut parts = Vec::new();
    let mut rest = name;
    while !rest.is_empty() {
        let digits = rest.find(|c: char| c.is_ascii_digit()).unwrap_or(rest.len());
        let (text, tail) = rest.split_at(digits);
        let end = tail.find(|c: char| !c.is_ascii_digit()).unwrap_or(tail.len());
        let (number, tail) = tail.split_at(end);
        // The digits themselves break ties between 1 and 01, and stand in for numbers beyond 64 bits.
        parts.push((text.to_owned(), number.parse().unwrap_or(u64::MAX), number.to_owned()));
        rest = tail;
    }
    parts
}

/// The numbers by which files count.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Numbers(Vec<u64>);

impl Numbers {
    /// The numbers of files in their order, by the last number in each name; `None` unless all have one, and they rise.
    pub fn of<'a>(files: impl IntoIterator<Item = &'a Path>) -> Option<Self> {
        let numbers = files.into_iter().map(|file| last_number(&file.file_stem()?.to_string_lossy()));
        let numbers: Vec<u64> = numbers.collect::<Option<_>>()?;
        let rises = numbers.windows(2).all(|pair| pair[0] < pair[1]);
        (rises && !numbers.is_empty()).then_some(Self(numbers))
    }

    /// The numbers.
    pub fn values(&self) -> &[u64] {
        &self.0
    }

    /// Which of `count` lines of a table belong to them: by their numbers, from 0, or from 1 where the last one is that of the last line.
    /// `None` where there are more of them than lines.
    pub fn places_in(&self, count: usize) -> Option<Vec<usize>> {
        let (first, last) = (*self.0.first()?, *self.0.last()?);
        let from = u64::from(first > 0 && last == count as u64);
        (last - from < count as u64).then(|| self.0.iter().map(|number| (number - from) as usize).collect())
    }

    /// What is missing among them, for people; nothing where they count evenly.
    pub fn gaps(&self) -> Option<String> {
        let steps = || self.0.windows(2).map(|pair| pair[1] - pair[0]);
        let usual = {
            let mut steps: Vec<u64> = steps().collect();
            steps.sort_unstable();
            *steps.get(steps.len().checked_sub(1)? / 2)?
        };
        let gaps = || self.0.windows(2).filter(|pair| pair[1] - pair[0] > usual);
        let (first, missing) =
            (gaps().next()?, gaps().map(|pair| (pair[1] - pair[0] - 1) / usual).sum::<u64>());
        let places = match gaps().count() {
            1 => String::new(),
            places => format!(", in {places} places"),
        };
        Some(format!(
            "numbers are missing: after {} comes {} ({missing} missing{places})",
            first[0], first[1]
        ))
    }
}

/// The last number in a name.
fn last_number(name: &str) -> Option<u64> {
    let end = name.rfind(|c: char| c.is_ascii_digit())? + 1;
    let start = name[..end]
        .rfind(|c: char| !c.is_ascii_digit())
        .map_or(0, |at| at + name[at..].chars().next().map_or(1, char::len_utf8));
    name[start..end].parse().ok()
}
