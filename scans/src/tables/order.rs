//! Names in the order in which people count.

use std::path::{Path, PathBuf};

/// Sorts files by their names as people count: by value where all of them count by decimals, negative or hexadecimal numbers, else as
/// `natural_key` has them.
pub fn sort_by_name(files: &mut [PathBuf]) {
    let name = |file: &Path| file.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let values = values_of(files);
    let mut order: Vec<usize> = (0..files.len()).collect();
    let keys: Vec<_> = files.iter().map(|file| natural_key(&name(file))).collect();
    order.sort_by(|&a, &b| {
        let by_value = values.as_ref().map(|values| values[a].total_cmp(&values[b]));
        by_value.unwrap_or(std::cmp::Ordering::Equal).then_with(|| keys[a].cmp(&keys[b]))
    });
    let sorted: Vec<PathBuf> = order.into_iter().map(|index| files[index].clone()).collect();
    files.clone_from_slice(&sorted);
}

/// The numbers that files are called by behind what all names share, where these are not plain ones.
fn values_of(files: &[PathBuf]) -> Option<Vec<f64>> {
    let stems: Vec<String> =
        files.iter().map(|file| Some(file.file_stem()?.to_str()?.to_owned())).collect::<Option<_>>()?;
    let first = stems.first()?;
    let same = |stem: &String| first.bytes().zip(stem.bytes()).take_while(|(a, b)| a == b).count();
    let shared = stems.iter().map(same).min()?;
    let shared = (0..=shared).rev().find(|at| first.is_char_boundary(*at)).unwrap_or(0);
    let is_of_number = |c: char| c.is_ascii_digit() || c == '.';
    let mut prefix = first[..shared].trim_end_matches(is_of_number);
    if prefix == "-" {
        prefix = "";
    }
    let numbers: Vec<&str> = stems.iter().map(|stem| stem.strip_prefix(prefix)).collect::<Option<_>>()?;
    if numbers.iter().any(|number| number.contains('.') || number.starts_with('-')) {
        let value = |number: &&str| {
            let is_number = number.bytes().all(|byte| byte.is_ascii_digit() || b".-".contains(&byte));
            number.parse().ok().filter(|_| is_number)
        };
        return numbers.iter().map(value).collect();
    }
    let has_letters = numbers.iter().any(|number| number.bytes().any(|byte| byte.is_ascii_alphabetic()));
    let value = |number: &&str| u64::from_str_radix(number, 16).ok().map(|value| value as f64);
    numbers.iter().map(value).collect::<Option<Vec<f64>>>().filter(|_| has_letters)
}

/// A name as alternating text and numbers, so that numbers compare by value.
pub(super) fn natural_key(name: &str) -> Vec<(String, u64, String)> {
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
