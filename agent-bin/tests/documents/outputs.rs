//! The outputs that README and book show are those of the program: each `console` block after `<!-- run -->` is run, in the
//! order of the book, in one folder with `demo/` in it.

use crate::commands::words;
use crate::common::command;
use crate::markdown::{blocks, book, repository};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::path::Path;

/// A line whose numbers may be others: each becomes one sign, and columns may be wider.
fn without_numbers(line: &str) -> String {
    let mut out = String::new();
    for word in line.split_whitespace() {
        let mut is_number = false;
        for c in word.chars() {
            let digit = c.is_ascii_digit() || (is_number && c == '.');
            if !(digit && is_number) {
                out.push(if digit { '0' } else { c });
            }
            is_number = digit;
        }
        out.push(' ');
    }
    out
}

/// The first line that is not in the output where it should be; `…` stands for any lines.
fn missing<'a>(expected: &[&'a str], output: &str) -> Option<&'a str> {
    let lines: Vec<String> = output.lines().map(without_numbers).collect();
    let (mut next, mut may_skip) = (0, false);
    for line in expected {
        if line.trim() == "…" {
            may_skip = true;
            continue;
        }
        let wanted = without_numbers(line);
        let skipped = lines[next..].iter().position(|line| *line == wanted);
        match skipped.filter(|skipped| may_skip || *skipped == 0) {
            Some(skipped) => next += skipped + 1,
            None => return Some(line),
        }
        may_skip = false;
    }
    None
}

/// What the command prints, on either output.
fn run(line: &str, folder: &Path) -> String {
    let parts = words(line);
    let [parts] = &parts[..] else { panic!("{line}: one command a line") };
    assert_eq!(parts[0], "loopbox", "{line}: only the program is run");
    let (path, wrong) = (folder.join("output"), format!("{line}: no output"));
    let file = File::create(&path).expect(&wrong);
    let status = command()
        .args(&parts[1..])
        .current_dir(folder)
        .stderr(file.try_clone().expect(&wrong))
        .stdout(file)
        .status()
        .expect(&wrong);
    let output = fs::read_to_string(&path).expect(&wrong);
    assert!(status.success(), "{line}\n{output}");
    output
}

#[cfg(unix)]
#[test]
fn documented_output_is_what_is_printed() {
    let folder = tempfile::tempdir().expect("a folder");
    std::os::unix::fs::symlink(repository().join("demo"), folder.path().join("demo")).expect("a link");
    let mut outputs: BTreeMap<String, String> = BTreeMap::new();
    let mut faults = Vec::new();
    for page in book() {
        for block in blocks(&page.text).iter().filter(|block| block.is_run) {
            assert_eq!(block.language, "console", "{}", page.name);
            for part in block.lines.join("\n").split("$ ").skip(1) {
                let (line, expected) = part.split_once('\n').unwrap_or((part, ""));
                let output = outputs.entry(line.to_owned()).or_insert_with(|| run(line, folder.path()));
                if let Some(missing) = missing(&expected.lines().collect::<Vec<_>>(), output) {
                    faults.push(format!(
                        "{}: {line}\nhas no line\n    {missing}\nwhere it should be, but prints\n{output}",
                        page.name
                    ));
                }
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    assert!(outputs.len() >= 8, "only {} commands were run", outputs.len());
}

#[test]
fn other_outputs_are_found() {
    let output = "begun\n90 of 90 frames, 1.5 ms\nwritten to out/a\n";
    assert_eq!(missing(&["…", "7 of 100 frames, 20 ms", "written to out/a"], output), None);
    assert_eq!(missing(&["90 of 90 frames, 1.5 ms"], output), Some("90 of 90 frames, 1.5 ms"));
    assert_eq!(missing(&["begun", "written to out/a"], output), Some("written to out/a"));
    assert_eq!(missing(&["…", "90 of 90 frames, 1.5 s"], output), Some("90 of 90 frames, 1.5 s"));
}
