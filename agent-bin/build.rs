//! Tells a released program from which commit it is built: `LOOPBOX_COMMIT` where a package without its history sets it, else by
//! Git; with a `+` where files were changed since. Builds of the profile `dev` are not told, so that a commit does not link all
//! tests anew.

use std::process::Command;

fn main() {
    println!("cargo::rerun-if-env-changed=LOOPBOX_COMMIT");
    let named = std::env::var("LOOPBOX_COMMIT").ok().filter(|name| !name.is_empty());
    let is_released = std::env::var("PROFILE").is_ok_and(|profile| profile == "release");
    let commit = named.or_else(|| is_released.then(by_git).flatten());
    println!("cargo::rustc-env=LOOPBOX_COMMIT={}", commit.unwrap_or_default());
    if !is_released {
        println!("cargo::rerun-if-changed=build.rs");
        return;
    }
    // Whatever the program is made of: a change of any of it may make the commit another one's.
    println!("cargo::rerun-if-changed=../Cargo.lock");
    for member in std::fs::read_dir("..").into_iter().flatten().flatten() {
        for part in
            ["Cargo.toml", "src"].map(|name| member.path().join(name)).iter().filter(|part| part.exists())
        {
            println!("cargo::rerun-if-changed={}", part.display());
        }
    }
    for git in ["HEAD", "index"].map(|name| git(&["rev-parse", "--git-path", name])).into_iter().flatten() {
        println!("cargo::rerun-if-changed={git}");
    }
}

fn by_git() -> Option<String> {
    let commit = git(&["rev-parse", "--short=10", "HEAD"])?;
    let changed =
        git(&["status", "--porcelain", "--untracked-files=no"]).is_none_or(|files| !files.is_empty());
    Some(if changed { commit + "+" } else { commit })
}

/// What Git says; `None` without it or outside a repository.
fn git(arguments: &[&str]) -> Option<String> {
    let text = Command::new("git").args(arguments).output().ok()?;
    text.status.success().then(|| String::from_utf8_lossy(&text.stdout).trim().to_owned())
}
