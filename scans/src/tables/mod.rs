//! Tables of times and file names as people and programs write them: what folders of scans and of images are timed by.
//!
//! Text may be UTF-8 or UTF-16, with or without a mark at its start. Fields are separated by semicolons, tabs, commas or blanks,
//! whichever all lines have; a first line without a time is a header, with or without `#`. Lines end as those of any system do.

mod columns;
mod order;
mod stamps;

pub use columns::Times;
pub use order::{Numbers, sort_by_name};
pub use stamps::{Stamps, Unit, moment, seconds, stamps_of_names};

use std::io;
use std::path::{Path, PathBuf};

/// A line of a table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Row {
    /// Its number in the file, from 1.
    pub line: usize,
    /// Its fields, of which there is at least one; none is empty but where two separators stand side by side.
    pub fields: Vec<String>,
    /// Whether blanks separate the fields, so that several of them may be one name.
    blanks: bool,
}

/// A table of times, names and numbers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Table {
    /// The lines that say what the columns are: comments before the first row, and a header.
    pub header: String,
    /// What a header that is a row calls the columns, in lower case; empty where there is none.
    pub names: Vec<String>,
    /// The rows.
    pub rows: Vec<Row>,
}

impl Table {
    /// Reads a table.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn read(path: &Path) -> io::Result<Self> {
        Ok(Self::parse(&decoded(&std::fs::read(path)?)))
    }

    /// The table in a text.
    pub fn parse(text: &str) -> Self {
        // Tables of old Macs and of some spreadsheets end lines by a carriage return alone.
        let returned = (!text.contains('\n') && text.contains('\r')).then(|| text.replace('\r', "\n"));
        let text = returned.as_deref().unwrap_or(text);
        let mut table = Self::default();
        let lines: Vec<(usize, &str)> = text
            .lines()
            .enumerate()
            .map(|(i, line)| (i + 1, without_comment(line).trim()))
            .filter(|(_, line)| !line.is_empty())
            .collect();
        let first = lines.first().map_or(usize::MAX, |(line, _)| *line);
        for line in text.lines().take(first.saturating_sub(1)) {
            table.header += line;
            table.header.push('\n');
        }
        let separator = Separator::of(lines.iter().map(|(_, line)| *line));
        table.rows = lines.into_iter().map(|(line, text)| separator.row(line, text)).collect();
        if let [first, second, ..] = &table.rows[..]
            && first.is_header_of(second)
        {
            let header = table.rows.remove(0);
            table.header += &header.text();
            table.names = header.fields.iter().map(|name| name.to_lowercase()).collect();
        }
        table
    }

    /// The first field of each row as times in seconds.
    ///
    /// # Errors
    /// The first row whose first field is no time.
    pub fn stamps(&self) -> Result<Stamps, &Row> {
        self.stamps_of(0)
    }

    /// The same of another column.
    ///
    /// # Errors
    /// The first row without a time there.
    pub fn stamps_of(&self, column: usize) -> Result<Stamps, &Row> {
        let texts = self.rows.iter().map(|row| row.fields.get(column).map_or("", String::as_str));
        Stamps::parse(texts, &self.header).map_err(|row| &self.rows[row])
    }
}

impl Row {
    /// The row as it is told to people.
    pub fn text(&self) -> String {
        self.fields.join(" ")
    }

    /// Whether this line, the first, says what the columns of the next one are: it has no time, where that one has some.
    fn is_header_of(&self, next: &Self) -> bool {
        let has_time = |row: &Self| row.fields.iter().any(|field| stamps::is_time(field));
        !has_time(self) && has_time(next)
    }

    /// The file in `folder` that the fields from `first` on name: as it is written, with the separators of Windows, of several
    /// words where blanks separate the fields, or by the end of a path that was written on another computer. Where there is
    /// none, what is written.
    pub fn file(&self, first: usize, folder: &Path) -> Option<PathBuf> {
        let fields = self.fields.get(first..).filter(|fields| !fields.is_empty())?;
        let most = if self.blanks { fields.len() } else { 1 };
        let names = || (1..=most).map(|count| fields[..count].join(" "));
        let found = names().find_map(|name| existing(folder, &name));
        // Unless it has an end, a name goes on behind the blank.
        let whole = names().find(|name| Path::new(name).extension().is_some());
        found.or_else(|| Some(folder.join(whole.unwrap_or_else(|| fields[0].clone()))))
    }
}

/// The file of this name, or of its end.
fn existing(folder: &Path, name: &str) -> Option<PathBuf> {
    let plain = folder.join(name);
    if plain.is_file() {
        return Some(plain);
    }
    let slashed = name.replace('\\', "/");
    let mut rest = slashed.trim_start_matches("./");
    loop {
        let path = folder.join(rest);
        if !rest.is_empty() && !rest.starts_with('/') && path.is_file() {
            return Some(path);
        }
        rest = rest.split_once('/')?.1;
    }
}

/// The text of a file: UTF-8, or UTF-16 of either order; what is neither is read as Latin-1 where it is no UTF-8.
pub fn decoded(bytes: &[u8]) -> String {
    let wide = |bytes: &[u8], read: fn([u8; 2]) -> u16| {
        let units: Vec<u16> = bytes.chunks_exact(2).map(|pair| read([pair[0], pair[1]])).collect();
        String::from_utf16_lossy(&units)
    };
    match bytes {
        [0xef, 0xbb, 0xbf, rest @ ..] => String::from_utf8_lossy(rest).into_owned(),
        [0xff, 0xfe, rest @ ..] => wide(rest, u16::from_le_bytes),
        [0xfe, 0xff, rest @ ..] => wide(rest, u16::from_be_bytes),
        // Digits and signs have a zero beside them there.
        [first, 0, ..] if *first != 0 => wide(bytes, u16::from_le_bytes),
        [0, second, ..] if *second != 0 => wide(bytes, u16::from_be_bytes),
        _ => match std::str::from_utf8(bytes) {
            Ok(text) => text.to_owned(),
            Err(_) => bytes.iter().map(|byte| char::from(*byte)).collect(),
        },
    }
}

/// A line without what follows `#`, which may also be a letter of a name.
fn without_comment(line: &str) -> &str {
    let starts = line.match_indices('#').map(|(at, _)| at);
    let comment =
        starts.into_iter().find(|at| line[..*at].chars().next_back().is_none_or(char::is_whitespace));
    &line[..comment.unwrap_or(line.len())]
}

/// What stands between fields.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Separator {
    Semicolon,
    Tab,
    Comma,
    Blanks,
}

impl Separator {
    /// The first that every line has; blanks where none is.
    fn of<'a>(lines: impl Iterator<Item = &'a str> + Clone) -> Self {
        let all = |has: fn(&str) -> bool| {
            let lacking = lines.clone().filter(|line| !has(line)).count();
            lines.clone().next().is_some() && lacking == 0
        };
        if all(|line| line.contains(';')) {
            Self::Semicolon
        } else if all(|line| line.contains('\t')) {
            Self::Tab
        } else if all(|line| line.contains(',')) && !all(has_decimal_comma) {
            Self::Comma
        } else {
            Self::Blanks
        }
    }

    fn row(self, line: usize, text: &str) -> Row {
        let trimmed = |field: &str| field.trim().trim_matches('"').trim().to_owned();
        let mut fields: Vec<String> = match self {
            Self::Semicolon => text.split(';').map(trimmed).collect(),
            Self::Tab => text.split('\t').map(trimmed).filter(|field| !field.is_empty()).collect(),
            // Tables of numbers have blanks as well, and one separator may be missing.
            Self::Comma => text.split(',').map(trimmed).collect(),
            Self::Blanks => words(text),
        };
        if let [date, hour, ..] = &fields[..]
            && let both = format!("{date} {hour}")
            && moment(&both).is_some()
        {
            fields.splice(..2, [both]);
        }
        if fields.is_empty() {
            fields.push(String::new());
        }
        while fields.len() > 1 && fields.last().is_some_and(String::is_empty) {
            fields.pop();
        }
        let is_decimal =
            |field: &str| field.matches(',').count() == 1 && field.replace(',', ".").parse::<f64>().is_ok();
        if self != Self::Comma && is_decimal(&fields[0]) {
            fields[0] = fields[0].replace(',', ".");
        }
        Row { line, fields, blanks: self == Self::Blanks }
    }
}

/// Whether a line begins with a number such as `0,033` and goes on after a blank.
fn has_decimal_comma(line: &str) -> bool {
    let mut words = line.split_whitespace();
    let first = words.next().and_then(|word| word.split_once(','));
    let is_number = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    words.next().is_some() && first.is_some_and(|(whole, part)| is_number(whole) && is_number(part))
}

/// The words of a line; what stands in quotes is one.
fn words(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut rest = text.trim_start();
    while !rest.is_empty() {
        let quoted = rest.strip_prefix('"').and_then(|inner| inner.split_once('"'));
        let (word, tail) = quoted
            .unwrap_or_else(|| rest.split_at(rest.find(|c: char| c.is_whitespace()).unwrap_or(rest.len())));
        found.push(word.trim_end_matches(',').to_owned());
        rest = tail.trim_start();
    }
    found.retain(|word| !word.is_empty());
    if found.is_empty() { vec![text.to_owned()] } else { found }
}

#[cfg(test)]
mod tests;
