//! The commands of README and book are ones that the program, the scripts and cargo understand.

use crate::markdown::{blocks, book, read, repository, spans};
use agent_bin::commands::Cli;
use clap::{Command, CommandFactory};
use std::fs;
use std::path::PathBuf;

/// The words of a line of a shell, command by command; comments, pipes and redirections left out.
pub fn words(line: &str) -> Vec<Vec<String>> {
    let mut commands = vec![Vec::new()];
    let mut word: Option<String> = None;
    let mut quote = None;
    for c in line.chars() {
        match (quote, c) {
            (Some(mark), c) if c == mark => quote = None,
            (None, '\'' | '"') => {
                quote = Some(c);
                word.get_or_insert_default();
            }
            (None, '#') if word.is_none() => break,
            (None, '|' | ';' | '&') => {
                commands.last_mut().expect("one").extend(word.take());
                commands.push(Vec::new());
            }
            (None, c) if c.is_whitespace() => commands.last_mut().expect("one").extend(word.take()),
            (_, c) => word.get_or_insert_default().push(c),
        }
    }
    commands.last_mut().expect("one").extend(word);
    commands.retain(|words| !words.is_empty());
    commands
}

/// The lines of a block that are commands.
fn lines(language: &str, lines: &[&str]) -> Vec<String> {
    match language {
        "console" => lines.iter().filter_map(|line| Some(line.strip_prefix("$ ")?.to_owned())).collect(),
        "sh" | "bash" => lines.iter().map(|line| (*line).to_owned()).collect(),
        _ => Vec::new(),
    }
}

/// The command that the words name, by its parents' too.
fn named<'a>(root: &'a Command, words: &[String]) -> &'a Command {
    words.iter().fold(root, |command, word| command.find_subcommand(word).unwrap_or(command))
}

/// What is wrong with the words of a command of the program.
fn program_fault(words: &[String]) -> Option<String> {
    let root = Cli::command();
    // What stands for something else, such as `loopbox run … --ros2`, is no whole command.
    if words.iter().any(|word| word.contains('…')) {
        let command = named(&root, &words[1..]);
        return words
            .iter()
            .filter_map(|word| word.strip_prefix("--"))
            .map(|word| word.split('=').next().expect("a part"))
            .find(|flag| !has_flag(command, flag))
            .map(|flag| format!("{} has no --{flag}", command.get_name()));
    }
    let error = root.try_get_matches_from(words).err()?;
    // Files that a page names are not here.
    if error.to_string().contains("nor a file that can be read") {
        return None;
    }
    use clap::error::ErrorKind::{DisplayHelp, DisplayVersion};
    (!matches!(error.kind(), DisplayHelp | DisplayVersion)).then(|| error.to_string())
}

fn has_flag(command: &Command, flag: &str) -> bool {
    matches!(flag, "help" | "version" | "json" | "")
        || command.get_arguments().any(|argument| {
            argument.get_long() == Some(flag)
                || argument.get_all_aliases().is_some_and(|aliases| aliases.contains(&flag))
        })
}

/// Whether any command has the flag, or a script, or cargo as README and book use it.
fn is_anybodys_flag(flag: &str) -> bool {
    fn in_command(command: &Command, flag: &str) -> bool {
        has_flag(command, flag) || command.get_subcommands().any(|command| in_command(command, flag))
    }
    let of_others =
        ["features", "no-default-features", "locked", "path", "release", "open", "example", "board"];
    in_command(&Cli::command(), flag) || of_others.contains(&flag) || is_scripts_flag(None, flag)
}

/// Whether a span is an option, or begins with the program, one of its commands, a script or cargo.
fn is_of_loopbox(span: &str) -> bool {
    let first = span.split(' ').next().unwrap_or_default();
    let ours = first == "loopbox" || first == "cargo" || first.starts_with("script/");
    ours || first.starts_with("--") && first != "-->" || Cli::command().find_subcommand(first).is_some()
}

/// Whether the script, or any one, knows the flag.
fn is_scripts_flag(script: Option<&str>, flag: &str) -> bool {
    let entries = fs::read_dir(repository().join("script")).expect("scripts are there");
    entries.filter_map(Result::ok).any(|entry| {
        script.is_none_or(|name| entry.file_name() == *name)
            && fs::read_to_string(entry.path()).is_ok_and(|text| text.contains(&format!("--{flag}")))
    })
}

fn script_fault(words: &[String]) -> Option<String> {
    let name = words[0].strip_prefix("script/").expect("a script");
    if !repository().join(&words[0]).is_file() {
        return Some(format!("there is no {}", words[0]));
    }
    let flags = words.iter().filter_map(|word| word.strip_prefix("--"));
    let wrong = flags
        .map(|flag| flag.split('=').next().expect("a part"))
        .find(|flag| !is_scripts_flag(Some(name), flag));
    wrong.map(|flag| format!("{} has no --{flag}", words[0]))
}

fn cargo_fault(words: &[String]) -> Option<String> {
    let root = repository();
    let manifest_in = |folder: PathBuf| fs::read_to_string(folder.join("Cargo.toml")).ok();
    let of_package = |name: &str| {
        let entries = fs::read_dir(&root).expect("the repository is there");
        let mut manifests = entries.filter_map(Result::ok).filter_map(|entry| manifest_in(entry.path()));
        manifests.find(|manifest| manifest.contains(&format!("[package]\nname = \"{name}\"\n")))
    };
    let after = |flag: &str| words.iter().position(|word| word == flag).and_then(|at| words.get(at + 1));
    let (package, manifest) = match (after("-p"), after("--path")) {
        (Some(name), _) => (&**name, of_package(name)),
        (None, Some(folder)) => (&**folder, manifest_in(root.join(folder))),
        (None, None) => ("loopbox", of_package("loopbox")),
    };
    let Some(manifest) = manifest else { return Some(format!("there is no package {package}")) };
    let wrong = after("--features")?.split(',').find(|name| !manifest.contains(&format!("\n{name} = [")))?;
    Some(format!("{package} has no feature {wrong}"))
}

fn fault(words: &[String]) -> Option<String> {
    match words.first()?.as_str() {
        "loopbox" | "target/release/loopbox" => program_fault(words),
        "sudo" => fault(&words[1..]),
        "cargo" => cargo_fault(words),
        script if script.starts_with("script/") => script_fault(words),
        _ => None,
    }
}

#[test]
fn each_command_is_understood() {
    let mut pages = book();
    pages.extend(
        ["CONTRIBUTING.md", "python/README.md", "demo/README.md"].map(|name| read(&repository(), name)),
    );
    let (mut faults, mut count) = (Vec::new(), 0);
    for page in &pages {
        let in_blocks = blocks(&page.text).into_iter().flat_map(|block| lines(block.language, &block.lines));
        // A span that names a command only, or shows what could follow, is no whole one.
        let in_text =
            spans(&page.text).into_iter().filter(|span| span.contains(' ')).map(|span| format!("{span} …"));
        for line in in_blocks.chain(in_text) {
            for words in words(&line) {
                count += usize::from(words[0] == "loopbox");
                faults.extend(fault(&words).map(|fault| format!("{}: {line}\n    {fault}", page.name)));
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    assert!(count > 100, "only {count} commands were found");
}

#[test]
fn each_option_that_is_named_is_one() {
    let mut faults = Vec::new();
    for page in book().iter().filter(|page| !page.name.ends_with("results.md")) {
        let of_loopbox = spans(&page.text).into_iter().filter(|span| is_of_loopbox(span));
        for word in of_loopbox.flat_map(|span| span.split([' ', '=', '[', ','])) {
            if let Some(flag) = word.strip_prefix("--").filter(|flag| !is_anybodys_flag(flag)) {
                faults.push(format!("{}: --{flag}", page.name));
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn wrong_commands_are_found() {
    let wrong = |line: &str| fault(&words(line)[0]);
    assert!(wrong("loopbox run a.mp4 --out b # --nothing").is_none());
    assert!(wrong("loopbox run a.mp4 --nothing").unwrap().contains("--nothing"));
    assert!(wrong("loopbox run … --nothing").unwrap().contains("--nothing"));
    assert!(wrong("loopbox fleet … --demo").is_none());
    assert!(wrong("script/setup --video").is_none());
    assert!(wrong("script/setup --nothing").unwrap().contains("--nothing"));
    assert!(wrong("script/nothing").unwrap().contains("script/nothing"));
    assert!(wrong("cargo build -p loopbox --features nothing").unwrap().contains("nothing"));
    assert!(wrong("cargo test -p loopbox-map NAME").is_none());
    assert!(wrong("cargo test -p map NAME").unwrap().contains("no package map"));
    assert!(wrong("cargo install --path agent-bin --features ros2").is_none());
    assert!(wrong("cargo install --path loopbox-map").unwrap().contains("no package loopbox-map"));
    assert_eq!(words("a 'b c' && d | e").len(), 3);
    assert!(!is_anybodys_flag("nothing-of-the-kind"));
}
