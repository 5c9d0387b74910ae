//! `loopbox eval --table`: several runs, each compared by itself, with their medians.

use crate::console;
use anyhow::{Context, Result};
use eval::{Evaluation, Options, Statistics, evaluate, read_times, read_trajectory};
use geometry::median;
use loopbox::evaluating::{read_truth, trajectory_at};
use loopbox::run::LIVE_TRAJECTORY;
use serde::Serialize;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Which runs are compared with what.
pub struct Runs<'a> {
    /// Trajectories, or folders of runs.
    pub estimates: &'a [PathBuf],
    /// A truth for each, or one for all.
    pub truths: &'a [PathBuf],
    /// Times of the recordings' frames, likewise; none where coverage counts poses of the truth.
    pub frames: &'a [PathBuf],
}

/// Where the rows go.
pub struct Form<'a> {
    /// Print JSON in place of a table.
    pub json: bool,
    /// Also write the rows into this file.
    pub csv: Option<&'a Path>,
}

/// What is printed as JSON.
#[derive(Serialize)]
struct Table {
    runs: Vec<Row>,
    recordings: Vec<Summary>,
}

/// A run. Errors in the unit of the truth.
#[derive(Clone, Debug, Serialize)]
struct Row {
    estimate: String,
    truth: String,
    poses: usize,
    /// Share of the frames, or of the truth's poses, with an estimate, 0–1.
    coverage: Option<f64>,
    ate: Statistics,
    rpe: Option<f64>,
    /// Root mean square error of the poses as they were tracked.
    live_ate: Option<f64>,
}

/// The runs that have one truth: the median, least and largest of their errors.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Summary {
    truth: String,
    runs: usize,
    ate_rmse: Spread,
    live_ate: Option<Spread>,
    coverage: Option<Spread>,
}

/// The middle, of an even number the upper one, and the ends of some values.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
struct Spread {
    median: f64,
    min: f64,
    max: f64,
}

impl Spread {
    fn of(mut values: Vec<f64>) -> Option<Self> {
        let end = |choose: fn(f64, f64) -> f64| values.iter().copied().reduce(choose);
        let (min, max) = (end(f64::min)?, end(f64::max)?);
        Some(Self { median: median(&mut values)?, min, max })
    }
}

/// Compares each run by itself, aligned by itself, and prints and writes the rows.
///
/// # Errors
/// When a file cannot be read or written, or a run and its truth have no times in common.
pub fn run(runs: &Runs, options: &Options, form: &Form) -> Result<()> {
    let rows = (0..runs.estimates.len()).map(|i| row(runs, i, options)).collect::<Result<Vec<_>>>()?;
    if let Some(path) = form.csv {
        std::fs::write(path, csv(&rows)?)
            .with_context(|| format!("{}: cannot be written", path.display()))?;
    }
    let recordings = summaries(&rows);
    if form.json {
        console::print_json(&Table { runs: rows, recordings })?;
    } else {
        console::print(&text(&rows, &recordings)?)?;
    }
    Ok(())
}

fn row(runs: &Runs, number: usize, options: &Options) -> Result<Row> {
    let (estimate, truth) =
        (&runs.estimates[number], of(runs.truths, number).expect("the caller counted them"));
    let frames = of(runs.frames, number).map(|path| read_times(path)).transpose()?;
    let compared = |path: &Path| -> Result<Evaluation> {
        let found = evaluate(read_trajectory(path)?, read_truth(truth)?, frames.as_deref(), options);
        found.with_context(|| format!("{} and {}", path.display(), truth.display()))
    };
    let path = trajectory_at(estimate)?;
    let Evaluation { pairs, ate, rpe, coverage, .. } = compared(&path)?;
    let live = Some(path.with_file_name(LIVE_TRAJECTORY)).filter(|live| estimate.is_dir() && live.is_file());
    Ok(Row {
        estimate: estimate.display().to_string(),
        truth: truth.display().to_string(),
        poses: pairs,
        coverage: coverage.map(|coverage| coverage.share),
        ate,
        rpe: rpe.map(|rpe| rpe.translation.rmse),
        live_ate: live.map(|live| Ok::<_, anyhow::Error>(compared(&live)?.ate.rmse)).transpose()?,
    })
}

/// The one of a run, or the only one.
fn of(paths: &[PathBuf], number: usize) -> Option<&PathBuf> {
    paths.get(number).or(paths.first())
}

/// By truth, in the order in which these come.
fn summaries(rows: &[Row]) -> Vec<Summary> {
    let mut truths: Vec<&str> = Vec::new();
    for row in rows {
        if !truths.contains(&row.truth.as_str()) {
            truths.push(&row.truth);
        }
    }
    let summary = |truth: &str| {
        let own: Vec<&Row> = rows.iter().filter(|row| row.truth == truth).collect();
        let spread =
            |value: fn(&Row) -> Option<f64>| Spread::of(own.iter().filter_map(|row| value(row)).collect());
        Some(Summary {
            truth: truth.to_owned(),
            runs: own.len(),
            ate_rmse: spread(|row| Some(row.ate.rmse))?,
            live_ate: spread(|row| row.live_ate),
            coverage: spread(|row| row.coverage),
        })
    };
    truths.into_iter().filter_map(summary).collect()
}

fn text(rows: &[Row], recordings: &[Summary]) -> Result<String, std::fmt::Error> {
    let mut out = String::new();
    let names = rows.iter().map(|row| &row.estimate).chain(recordings.iter().map(|one| &one.truth));
    let width = names.map(|name| name.chars().count()).max().unwrap_or(0).max(9);
    let number = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.4}"));
    let percent =
        |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{:.1} %", 100.0 * value));
    writeln!(
        out,
        "{:<width$}{:>8}{:>10}{:>10}{:>12}{:>10}{:>10}{:>10}",
        "run", "poses", "coverage", "ATE rmse", "ATE median", "ATE max", "live ATE", "RPE rmse"
    )?;
    for row in rows {
        let (Row { estimate, poses, ate, .. }, coverage) = (row, percent(row.coverage));
        let (live, rpe) = (number(row.live_ate), number(row.rpe));
        write!(out, "{estimate:<width$}{poses:>8}{coverage:>10}{:>10.4}{:>12.4}", ate.rmse, ate.median)?;
        writeln!(out, "{:>10.4}{live:>10}{rpe:>10}", ate.max)?;
    }
    let range = |spread: Option<Spread>| {
        spread
            .map_or("-".to_owned(), |Spread { median, min, max }| format!("{median:.4} ({min:.4}–{max:.4})"))
    };
    writeln!(
        out,
        "\n{:<width$}{:>6}{:>28}{:>28}{:>16}",
        "recording", "runs", "ATE rmse", "live ATE", "least coverage"
    )?;
    for Summary { truth, runs, ate_rmse, live_ate, coverage } in recordings {
        let (ate, live) = (range(Some(*ate_rmse)), range(*live_ate));
        let least = percent(coverage.map(|coverage| coverage.min));
        writeln!(out, "{truth:<width$}{runs:>6}{ate:>28}{live:>28}{least:>16}")?;
    }
    writeln!(
        out,
        "\nerrors in the unit of the truth, each run aligned by itself; recordings: median (least–largest)"
    )?;
    Ok(out)
}

/// The rows, with quotes where a name needs them.
fn csv(rows: &[Row]) -> Result<String, std::fmt::Error> {
    let quoted = |name: &str| match name.contains(['"', ',', '\n', '\r']) {
        true => format!("\"{}\"", name.replace('"', "\"\"")),
        false => name.to_owned(),
    };
    let number = |value: Option<f64>| value.map_or(String::new(), |value| value.to_string());
    let mut out =
        "estimate,truth,poses,coverage,ate_rmse,ate_mean,ate_median,ate_max,live_ate_rmse,rpe_rmse\n"
            .to_owned();
    for Row { estimate, truth, poses, coverage, ate, rpe, live_ate } in rows {
        let (estimate, truth, coverage) = (quoted(estimate), quoted(truth), number(*coverage));
        write!(
            out,
            "{estimate},{truth},{poses},{coverage},{},{},{},{}",
            ate.rmse, ate.mean, ate.median, ate.max
        )?;
        writeln!(out, ",{},{}", number(*live_ate), number(*rpe))?;
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(estimate: &str, truth: &str, rmse: f64, live_ate: Option<f64>) -> Row {
        let ate =
            Statistics { count: 10, rmse, mean: rmse, median: rmse, std: 0.0, min: 0.0, max: rmse, sse: 0.0 };
        let (estimate, truth) = (estimate.to_owned(), truth.to_owned());
        Row { estimate, truth, poses: 10, coverage: Some(0.5), ate, rpe: None, live_ate }
    }

    #[test]
    fn runs_of_one_recording_have_one_median() {
        let rows = [
            row("a", "x", 3.0, Some(4.0)),
            row("b", "y", 9.0, None),
            row("c", "x", 1.0, None),
            row("d", "x", 2.0, None),
        ];
        let found = summaries(&rows);
        assert_eq!(
            found.iter().map(|one| (one.truth.as_str(), one.runs)).collect::<Vec<_>>(),
            [("x", 3), ("y", 1)]
        );
        assert_eq!(found[0].ate_rmse, Spread { median: 2.0, min: 1.0, max: 3.0 });
        assert_eq!(found[0].live_ate, Some(Spread { median: 4.0, min: 4.0, max: 4.0 }));
        assert_eq!(found[1].live_ate, None);
    }

    #[test]
    fn names_with_commas_are_quoted() {
        let written = csv(&[row("out/a, \"second\"", "x", 1.5, None)]).unwrap();
        let second = written.lines().nth(1).unwrap();
        assert_eq!(second, "\"out/a, \"\"second\"\"\",x,10,0.5,1.5,1.5,1.5,1.5,,");
    }
}
