//! As much of Markdown as the pages use.

use std::fs;
use std::path::{Path, PathBuf};

/// A page and its text.
pub struct Page {
    /// Within the repository, for messages.
    pub name: String,
    pub path: PathBuf,
    pub text: String,
}

/// A fenced block.
#[derive(Debug, PartialEq)]
pub struct Block<'a> {
    pub language: &'a str,
    /// `<!-- run -->` stands above it.
    pub is_run: bool,
    pub lines: Vec<&'a str>,
}

pub fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().expect("the repository is there")
}

/// README and the book's chapters, in the order of its summary.
pub fn book() -> Vec<Page> {
    let root = repository();
    let summary = read(&root, "book/src/SUMMARY.md");
    let chapters = links(&summary.text).into_iter().map(|chapter| format!("book/src/{chapter}"));
    std::iter::once("README.md".to_owned()).chain(chapters).map(|name| read(&root, &name)).collect()
}

/// Every page of the repository.
pub fn everything() -> Vec<Page> {
    let root = repository();
    let mut names = Vec::new();
    for folder in [
        "",
        "bench",
        "bench/results",
        "demo",
        "docs",
        "python",
        "book/src",
        "book/src/dev",
        "book/src/guide",
        "book/src/reference",
        "book/src/results",
    ] {
        for entry in fs::read_dir(root.join(folder)).expect("the folder is there") {
            let name = Path::new(folder).join(entry.expect("it can be listed").file_name());
            names.extend(name.to_str().filter(|name| name.ends_with(".md")).map(str::to_owned));
        }
    }
    names.sort();
    names.iter().map(|name| read(&root, name)).collect()
}

pub fn read(root: &Path, name: &str) -> Page {
    let path = root.join(name);
    let text = fs::read_to_string(&path).unwrap_or_else(|error| panic!("{name}: {error}"));
    Page { name: name.to_owned(), path, text }
}

/// Fenced blocks in order.
pub fn blocks(text: &str) -> Vec<Block<'_>> {
    let mut found: Vec<Block<'_>> = Vec::new();
    let (mut is_open, mut is_run) = (false, false);
    for line in text.lines() {
        match line.trim_start().strip_prefix("```") {
            Some(_) if is_open => (is_open, is_run) = (false, false),
            Some(language) => {
                found.push(Block { language: language.trim(), is_run, lines: Vec::new() });
                is_open = true;
            }
            None if is_open => found.last_mut().expect("it was opened").lines.push(line),
            None => is_run = line.trim() == "<!-- run -->" || (is_run && line.trim().is_empty()),
        }
    }
    assert!(!is_open, "a fence is not closed");
    found
}

/// The lines that stand in no fence.
pub fn prose(text: &str) -> Vec<&str> {
    let mut is_code = false;
    let mut lines = Vec::new();
    for line in text.lines() {
        if line.trim_start().starts_with("```") {
            is_code = !is_code;
        } else if !is_code {
            lines.push(line);
        }
    }
    lines
}

/// Code within lines, without its back-ticks.
pub fn spans(text: &str) -> Vec<&str> {
    prose(text).into_iter().flat_map(|line| line.split('`').skip(1).step_by(2)).collect()
}

/// Targets of links and images.
pub fn links(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    for line in prose(text) {
        let line: String = line.split('`').step_by(2).collect();
        let parts = line.split("](").skip(1);
        found.extend(parts.filter_map(|part| Some(part.split_once(')')?.0.to_owned())));
    }
    found
}

/// The names of a page's headings, as GitHub and mdBook make them.
pub fn anchors(text: &str) -> Vec<String> {
    let headings = prose(text).into_iter().filter(|line| line.starts_with('#'));
    let slug = |line: &str| {
        let title = line.trim_start_matches('#').trim().to_lowercase();
        let kept = title.chars().filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
        kept.map(|c| if c == ' ' { '-' } else { c }).collect()
    };
    headings.map(slug).collect()
}

/// Rows of a page's tables as cells, each with the first row of its table.
pub fn rows(text: &str) -> Vec<(Vec<&str>, Vec<&str>)> {
    let mut found = Vec::new();
    let mut head: Option<Vec<&str>> = None;
    for line in prose(text) {
        let Some(line) = line.strip_prefix('|') else {
            head = None;
            continue;
        };
        let cells: Vec<&str> = line.trim_end().trim_end_matches('|').split('|').map(str::trim).collect();
        match &head {
            None => head = Some(cells),
            Some(_) if cells.iter().all(|cell| cell.chars().all(|c| matches!(c, '-' | ':'))) => {}
            Some(head) => found.push((head.clone(), cells)),
        }
    }
    found
}

#[test]
fn markdown_is_taken_apart() {
    let text = "# A `b`, c!\nsee [x](y.md#z) and `[no](link)`\n<!-- run -->\n```console\n$ a\n```\n| h | i |\n|---|---|\n| 1 | `2` |\n";
    assert_eq!(anchors(text), ["a-b-c"]);
    assert_eq!(links(text), ["y.md#z"]);
    assert_eq!(blocks(text), [Block { language: "console", is_run: true, lines: vec!["$ a"] }]);
    assert_eq!(spans(text), ["b", "[no](link)", "2"]);
    assert_eq!(rows(text), [(vec!["h", "i"], vec!["1", "`2`"])]);
}
