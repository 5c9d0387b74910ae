//! Links within the repository lead somewhere.

use crate::markdown::{Page, anchors, everything, links, read, repository};
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

/// The text with what mdBook includes in it.
fn whole(page: &Page) -> String {
    let folder = page.path.parent().expect("a page lies in a folder");
    let part = |line: &str| match line.strip_prefix("{{#include ").and_then(|rest| rest.strip_suffix("}}")) {
        Some(file) => {
            fs::read_to_string(folder.join(file)).unwrap_or_else(|_| panic!("{}: no {file}", page.name))
        }
        None => line.to_owned(),
    };
    page.text.lines().map(|line| part(line) + "\n").collect()
}

/// What is wrong with a link of a page.
fn fault(page: &Page, link: &str) -> Option<String> {
    if link.contains("://") || link.starts_with("mailto:") {
        return None;
    }
    let (file, anchor) = link.split_once('#').map_or((link, None), |(file, anchor)| (file, Some(anchor)));
    let target = match file {
        "" => page.path.clone(),
        _ => page.path.parent()?.join(file),
    };
    if !target.exists() {
        return Some(format!("{}: there is no {link}", page.name));
    }
    let anchor = anchor?;
    let text =
        whole(&Page { name: page.name.clone(), text: fs::read_to_string(&target).ok()?, path: target });
    (!anchors(&text).iter().any(|name| name == anchor))
        .then(|| format!("{}: {file} has no heading #{anchor}", page.name))
}

#[test]
fn each_link_has_its_target() {
    let pages = everything();
    let faults: Vec<String> = pages
        .iter()
        .flat_map(|page| links(&page.text).into_iter().filter_map(|link| fault(page, &link)))
        .collect();
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    assert!(
        pages.iter().map(|page| links(&page.text).len()).sum::<usize>() > 100,
        "hardly any link was found"
    );
}

/// mdBook copies what lies in its folder, and nothing from outside.
#[test]
fn no_chapter_leads_out_of_the_book() {
    let book = repository().join("book/src");
    for page in everything().iter().filter(|page| page.path.starts_with(&book)) {
        for link in links(&page.text).iter().filter(|link| !link.contains("://") && !link.starts_with('#')) {
            let file = link.split('#').next().expect("a part");
            let target = page.path.parent().expect("a folder").join(file);
            let target = target.canonicalize().unwrap_or_else(|_| panic!("{}: {link}", page.name));
            assert!(target.starts_with(&book), "{}: {link} leads out of the book", page.name);
        }
    }
}

#[test]
fn the_summary_names_each_chapter_once() {
    let root = repository();
    let listed = links(&read(&root, "book/src/SUMMARY.md").text);
    let there: BTreeSet<String> = everything()
        .iter()
        .filter_map(|page| page.name.strip_prefix("book/src/").map(str::to_owned))
        .filter(|name| name != "SUMMARY.md")
        .collect();
    assert_eq!(listed.iter().cloned().collect::<BTreeSet<_>>(), there);
    assert_eq!(listed.len(), there.len(), "a chapter is listed twice");
}

#[test]
fn wrong_links_are_found() {
    let root = repository();
    let page = read(&root, "README.md");
    assert!(fault(&page, "book/src/tutorial.md#what-next").is_none());
    assert!(fault(&page, "https://example.org/").is_none());
    assert!(fault(&page, "book/src/tutorial.md#nowhere").unwrap().contains("no heading"));
    assert!(fault(&page, Path::new("nowhere.md").to_str().unwrap()).unwrap().contains("there is no"));
}
