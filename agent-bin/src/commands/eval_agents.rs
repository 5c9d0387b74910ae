//! `loopbox eval` of several agents in one common frame.

use crate::console;
use anyhow::Result;
use eval::{AgentEvaluation, AgentsEvaluation, AlignMode};
use serde::Serialize;
use std::fmt::Write;
use std::path::PathBuf;

/// What is printed as JSON.
#[derive(Serialize)]
struct Output<'a> {
    align: AlignMode,
    truth_from_estimate: geometry::Sim3,
    agents: Vec<Agent<'a>>,
}

/// An agent's file with its numbers.
#[derive(Serialize)]
struct Agent<'a> {
    estimate: &'a str,
    #[serde(flatten)]
    evaluation: &'a AgentEvaluation,
}

/// Prints the numbers of the agents whose estimates are in the files `names`.
pub fn print(names: &[PathBuf], found: &AgentsEvaluation, align: AlignMode, json: bool) -> Result<()> {
    let names: Vec<String> = names.iter().map(|name| name.display().to_string()).collect();
    if json {
        let agents = names.iter().zip(&found.agents);
        let agents = agents.map(|(estimate, evaluation)| Agent { estimate, evaluation }).collect();
        let output = Output { align, truth_from_estimate: found.truth_from_estimate, agents };
        console::print_json(&output)?;
    } else {
        console::print(&table(&names, found, align)?)?;
    }
    Ok(())
}

fn table(names: &[String], found: &AgentsEvaluation, align: AlignMode) -> Result<String, std::fmt::Error> {
    let mut out = String::new();
    let scale = found.truth_from_estimate.scale;
    match align {
        AlignMode::None => writeln!(out, "alignment   none")?,
        AlignMode::Se3 => writeln!(out, "alignment   SE(3) of the first agent, for all")?,
        AlignMode::Sim3 => writeln!(out, "alignment   Sim(3) of the first agent, for all; scale {scale:.6}")?,
        AlignMode::Scale => writeln!(out, "alignment   scale of the first agent, for all; {scale:.6}")?,
    }
    let width = names.iter().map(|name| name.chars().count()).max().unwrap_or(0);
    writeln!(
        out,
        "\n{:<width$}{:>8}{:>11}{:>11}{:>12}{:>11}{:>10}{:>11}{:>11}",
        "agent", "poses", "coverage", "ATE rmse", "ATE median", "ATE max", "scale %", "turn deg", "offset m"
    )?;
    for (name, AgentEvaluation { evaluation, merge }) in names.iter().zip(&found.agents) {
        let unknown = || "-".to_owned();
        let covered = evaluation.coverage.map_or_else(unknown, |c| format!("{:.1} %", 100.0 * c.share));
        let ate = &evaluation.ate;
        write!(out, "{name:<width$}{:>8}{covered:>11}", evaluation.pairs)?;
        write!(out, "{:>11.4}{:>12.4}{:>11.4}", ate.rmse, ate.median, ate.max)?;
        let numbers = merge.map(|m| {
            [format!("{:+.3}", m.scale_percent), format!("{:.3}", m.rotation_deg), format!("{:.4}", m.offset)]
        });
        let [scale, rotation, offset] = numbers.unwrap_or_else(|| [unknown(), unknown(), unknown()]);
        writeln!(out, "{scale:>10}{rotation:>11}{offset:>11}")?;
    }
    writeln!(
        out,
        "\nATE in metres; scale, turn and offset: by how much an agent alone fits otherwise than the first"
    )?;
    Ok(out)
}
