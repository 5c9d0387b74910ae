//! The files that merged maps are written into.

use super::{Input, Manifest, MergeRecord, Merging, Names, report};
use crate::common_map::groups::{self, GroupFiles, GroupMap};
use crate::results::Results;
use anyhow::{Context, Result};
use std::fs::File;
use std::io::{BufWriter, Write};

const REPORT: &str = "report.html";
const NUMBERS: &str = "merge.json";

/// Writes the results of a merging into `output`, of which `manifest` is what they are made of; `record` learns their names and is
/// written last.
///
/// # Errors
/// Names the file that cannot be written.
pub fn write_results(
    output: &mut Results,
    inputs: &[Input],
    merging: &Merging,
    names: &Names,
    manifest: Option<&Manifest>,
    record: &mut MergeRecord,
) -> Result<()> {
    let provenance = merging.provenance(inputs, &record.params);
    manifest.map_or(Ok(()), |manifest| manifest.write(output))?;
    let groups: Vec<GroupMap> = merging.fused.iter().map(|fused| GroupMap::of(fused, names)).collect();
    let files = GroupFiles::of(output, &groups)?;
    let page = output.file(REPORT)?;
    let (maps, report) =
        rayon::join(|| groups::fill(&files, &groups, &provenance), || report::write(&page, inputs, merging));
    maps?;
    report.with_context(|| format!("{}: cannot be written", page.display()))?;
    let path = output.file(NUMBERS)?;
    record.files = output.names();
    let context = || format!("{}: cannot be written", path.display());
    let mut file = BufWriter::new(File::create(&path).with_context(context)?);
    serde_json::to_writer_pretty(&mut file, record).with_context(context)?;
    file.flush().with_context(context)
}
