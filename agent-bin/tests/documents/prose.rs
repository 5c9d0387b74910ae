//! README stays short, and what people read first is plain.

use crate::markdown::{Page, everything, prose, read, repository};

const LINES: usize = 120;
const WORDS: usize = 30;

/// What people read first, beside the pages of tasks.
const PAGES: [&str; 9] = [
    "README.md",
    "ARCHITECTURE.md",
    "book/src/introduction.md",
    "book/src/install.md",
    "book/src/tutorial.md",
    "book/src/concepts.md",
    "book/src/benchmarks.md",
    "book/src/limits.md",
    "book/src/reference/exit-codes.md",
];

/// The sentences of a page without its code: paragraphs, items of lists and cells of tables end one, too.
fn sentences(text: &str) -> Vec<String> {
    let mut found = vec![String::new()];
    for line in prose(text) {
        let line = line.trim();
        let is_apart =
            line.is_empty() || ["#", "|", "* ", "!", "<!--"].iter().any(|mark| line.starts_with(mark));
        if is_apart {
            found.push(String::new());
        }
        let cells: Vec<&str> = if line.starts_with('|') { line.split('|').collect() } else { vec![line] };
        for (at, cell) in cells.into_iter().enumerate() {
            if at > 0 {
                found.push(String::new());
            }
            for word in without_targets(cell).split_whitespace() {
                let sentence = found.last_mut().expect("one");
                *sentence += &format!("{word} ");
                if word.ends_with(['.', '?', '!']) {
                    found.push(String::new());
                }
            }
        }
    }
    found
}

/// The text of links without where they lead.
fn without_targets(line: &str) -> String {
    let mut parts = line.split("](");
    let first = parts.next().unwrap_or_default().to_owned();
    parts.fold(first, |text, part| text + part.split_once(')').map_or("", |(_, rest)| rest))
}

#[test]
fn the_readme_is_short() {
    let page = read(&repository(), "README.md");
    assert!(page.text.lines().count() <= LINES, "README.md has more than {LINES} lines");
}

#[test]
fn sentences_of_the_first_pages_are_short() {
    let is_first = |name: &str| PAGES.contains(&name) || name.starts_with("book/src/guide/");
    let pages: Vec<Page> = everything().into_iter().filter(|page| is_first(&page.name)).collect();
    for page in &pages {
        let long: Vec<String> = sentences(&page.text)
            .into_iter()
            .filter(|sentence| sentence.split_whitespace().count() > WORDS)
            .collect();
        assert!(long.is_empty(), "{}: more than {WORDS} words:\n{}", page.name, long.join("\n"));
    }
    assert!(pages.len() > PAGES.len() + 15, "{} pages", pages.len());
}

#[test]
fn sentences_are_counted() {
    let found = sentences(
        "# Title\nOne two\nthree. Four [five six](seven eight)\n* item\n\n```sh\na b c\n```\n| x | y z |\n",
    );
    let full: Vec<&str> = found.iter().map(|s| s.trim()).filter(|s| !s.is_empty()).collect();
    assert_eq!(full, ["# Title One two three.", "Four [five six", "* item", "x", "y z"]);
}
