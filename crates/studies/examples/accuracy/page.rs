//! The page of tables.

use crate::Outcome;
use clap::Args;
use scopeservo_studies::accuracy::rows::{self, Row, by_method};
use scopeservo_studies::accuracy::scenes::set_name;
use scopeservo_studies::accuracy::table;
use std::path::PathBuf;

/// What `table` is asked.
#[derive(Args)]
pub(crate) struct TableArgs {
    /// Our results.
    #[arg(long)]
    ours: PathBuf,
    /// The peers' results.
    #[arg(long)]
    peers: PathBuf,
    /// The engine of ours that counts: the last one in the file unless told.
    #[arg(long)]
    engine: Option<String>,
    /// The machine, in words.
    #[arg(long, default_value = "not stated")]
    machine: String,
    /// The page to write.
    #[arg(long, default_value = "docs/sift-accuracy.md")]
    out: PathBuf,
}

pub(crate) fn run(args: &TableArgs, seed: u64) -> Outcome<()> {
    let set = set_name(seed);
    let theirs = rows::read(&args.peers, &set)?;
    let mut ours = rows::read(&args.ours, &set)?;
    let newest = ours.last().map(|row| row.engine.clone());
    let engine = args.engine.clone().or(newest);
    let engine = engine.ok_or("there are no results of ours")?;
    ours.retain(|row| row.engine == engine);
    let peer = theirs.last().map_or("no peer", |row: &Row| &row.engine);
    let peer = peer.to_string();
    let methods = by_method([ours, theirs].concat());
    table::check_frames(&methods)?;
    let page = include_str!("page.md")
        .replace("{ENGINE}", &engine)
        .replace("{PEER}", &peer)
        .replace("{MACHINE}", &args.machine)
        .replace("{SET}", &set)
        .replace("{LEGEND}", table::legend().trim_end())
        .replace("{SUMMARY}", table::summary(&methods).trim_end())
        .replace("{FAST}", table::fast_modes(&methods).trim_end())
        .replace("{AIMS}", table::aims(&methods).trim_end())
        .replace("{TABLE_ONE}", table::table_one(&methods).trim_end())
        .replace(
            "{LOST_EQUAL}",
            table::lost_pairs(&methods, "equal", 40).trim_end(),
        )
        .replace(
            "{LOST_2000}",
            table::lost_pairs(&methods, "2000", 40).trim_end(),
        )
        .replace("{CELLS}", table::all_cells(&methods).trim_end());
    std::fs::write(&args.out, page)?;
    println!("{}\n{}", table::summary(&methods), table::aims(&methods));
    Ok(())
}
