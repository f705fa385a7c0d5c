//! The page that compares the methods: Markdown from rows.

use super::comparison::{Comparison, Figures, cells, compare, middle, of_cell, sure_pairs_lost};
pub use super::comparison::{Methods, PRECISE, check_frames};
use super::degrade::Condition;
use super::ours::{SETTINGS, Setting};
use super::rows::{ByPair, Row};
use super::scenes::{PairId, ZOOMS};
use std::collections::BTreeMap;
use std::fmt::Write;

/// The peers in the order of the tables: name in the results, name in the tables, what Table I of the paper says of speed and
/// accuracy.
pub const PEERS: [(&str, &str, &str, &str); 5] = [
    (PRECISE, "OpenCV SIFT, precise upscale", "slow", "very high"),
    ("opencv_sift", "OpenCV SIFT, default", "slow", "very high"),
    ("opencv_akaze", "OpenCV AKAZE", "medium", "medium"),
    ("opencv_brisk", "OpenCV BRISK", "fast", "high"),
    ("opencv_orb", "OpenCV ORB", "very fast", "low"),
];
/// Medians to aim for: zoom, condition, target pixels.
const AIMS: [(usize, Condition, f64); 5] = [
    (1, Condition::Clean, 0.02),
    (2, Condition::Clean, 0.05),
    (4, Condition::Clean, 0.15),
    (1, Condition::Occlusion, 0.02),
    (1, Condition::All, 0.15),
];

fn settings(methods: &Methods) -> impl Iterator<Item = (&'static Setting, &ByPair)> {
    SETTINGS
        .iter()
        .filter_map(|s| Some((s, methods.get(s.name)?)))
}

fn peers(methods: &Methods) -> impl Iterator<Item = (&'static str, &'static str, &ByPair)> {
    PEERS
        .into_iter()
        .filter_map(|(name, title, ..)| Some((name, title, methods.get(name)?)))
}

/// Pixels with the digits that matter; `-` for what is not there.
fn px(value: f64) -> String {
    match value {
        v if !v.is_finite() => "-".into(),
        v if v < 1.0 => format!("{v:.4}"),
        v if v < 100.0 => format!("{v:.2}"),
        v => format!("{v:.0}"),
    }
}

fn share(part: usize, of: usize) -> String {
    format!("{:.3}", part as f64 / of.max(1) as f64)
}

/// The verdict on each of our settings.
pub fn summary(methods: &Methods) -> String {
    let mut out = String::from(
        "| ours | pairs | cells that pass against precise | without a median | cells that fail, with ours / precise | \
         sure pairs lost | aims met | rough answers | misleading | features ms | register ms |\n\
         |---|---|---|---|---|---|---|---|---|---|---|\n",
    );
    for (setting, rows) in settings(methods) {
        let against = methods.get(PRECISE).map(|p| compare(rows, p));
        let against = against.unwrap_or_default();
        let (lost, sure) = sure_pairs_lost(methods, rows);
        let aims: Vec<bool> = AIMS
            .iter()
            .filter_map(|aim| aim_met(rows, *aim).map(|(_, met)| met))
            .collect();
        let all = Figures::of(rows.values());
        let ms = |of: fn(&Row) -> f64| middle(rows.values().map(of).collect());
        let _ = writeln!(
            out,
            "| {} | {} | {} | {} of {sure} | {} of {} | {} | {} | {:.0} | {:.0} |",
            setting.name,
            rows.len(),
            outcome(&against),
            lost.len(),
            aims.iter().filter(|met| **met).count(),
            aims.len(),
            all.rough,
            all.misleading,
            ms(|r| r.features_ms),
            ms(|r| r.register_ms),
        );
    }
    out
}

/// Failing cells that are named in one line; every cell has its verdict below.
const NAMED: usize = 4;

/// Three columns: cells that pass, cells without a median to compare, and what fails.
fn outcome(against: &[Comparison]) -> String {
    let passed = against.iter().filter(|c| c.holds()).count();
    let unjudged = against.iter().filter(|c| c.medians_px.is_none()).count();
    let failed: Vec<String> = against.iter().filter(|c| !c.holds()).map(failure).collect();
    let first = &failed[..failed.len().min(NAMED)];
    let named = match failed.len() {
        0 => "none".into(),
        n if n > NAMED => format!("{}; and {} more", first.join("; "), n - NAMED),
        _ => first.join("; "),
    };
    format!("{passed} of {} | {unjudged} | {named}", against.len())
}

/// Each fast mode against the setting that it would replace, by the same rule.
const REPLACES: [(&str, &str); 5] = [
    ("undoubled", "2000"),
    ("undoubled_scale", "2000_scale"),
    ("skip_scale", "2000_scale"),
    ("undoubled_skip_scale", "2000_scale"),
    ("servo_skip", "servo"),
];

/// The fast modes against our own.
pub fn fast_modes(methods: &Methods) -> String {
    let mut out = String::from(
        "| fast mode | in place of | cells that pass | without a median | cells that fail, with fast / full |\n\
         |---|---|---|---|---|\n",
    );
    for (fast, full) in REPLACES {
        if let (Some(a), Some(b)) = (methods.get(fast), methods.get(full)) {
            let _ = writeln!(out, "| {fast} | {full} | {} |", outcome(&compare(a, b)));
        }
    }
    out
}

fn failure(c: &Comparison) -> String {
    let mut text = format!("{}:1 {}", c.cell.0, c.cell.1.name());
    if !c.median_holds()
        && let Some([ours, peer]) = c.medians_px
    {
        let _ = write!(text, " median {} / {}", px(ours), px(peer));
    }
    if !c.success_holds() {
        let _ = write!(
            text,
            " success: {} lost, {} won of {}, p {:.1e}",
            c.losses, c.wins, c.pairs, c.chance
        );
    }
    text
}

/// The median of the aim's cell and whether it is good enough; `None` without pairs.
fn aim_met(
    rows: &ByPair,
    (zoom, condition, aim_px): (usize, Condition, f64),
) -> Option<(f64, bool)> {
    let figures = Figures::of(of_cell(rows, (zoom, condition)).map(|(_, r)| r));
    (figures.pairs > 0).then_some((figures.median_px, figures.median_px <= aim_px))
}

/// The medians to aim for, and everyone's.
pub fn aims(methods: &Methods) -> String {
    let mut out = String::from("| method |");
    for (zoom, condition, aim) in AIMS {
        let _ = write!(out, " {zoom}:1 {}, aim {aim} |", condition.name());
    }
    out.push_str("\n|---|---|---|---|---|---|\n");
    let ours = settings(methods).map(|(s, rows)| (s.name, rows));
    for (name, rows) in ours.chain(peers(methods).map(|(_, title, rows)| (title, rows))) {
        let _ = write!(out, "| {name} |");
        for aim in AIMS {
            let text = match aim_met(rows, aim) {
                Some((median, true)) => px(median),
                Some((median, false)) => format!("**{}**", px(median)),
                None => String::new(),
            };
            let _ = write!(out, " {text} |");
        }
        out.push('\n');
    }
    out
}

/// The paper's Table I with numbers.
pub fn table_one(methods: &Methods) -> String {
    let mut out = String::from(
        "| method | the paper: speed | accuracy | features ms | 1:1 clean success | median px | 2:1 clean success | median px \
         | 4:1 clean success | median px | success in all cells of 1:1 | 2:1 | 4:1 |\n\
         |---|---|---|---|---|---|---|---|---|---|---|---|---|\n",
    );
    let ours = settings(methods)
        .filter(|(s, _)| ["equal", "2000", "2000_scale"].contains(&s.name))
        .map(|(s, rows)| (format!("ours, {}", s.name), "slow", "very high", rows));
    let theirs = PEERS
        .into_iter()
        .filter_map(|(name, title, speed, accuracy)| {
            Some((title.to_string(), speed, accuracy, methods.get(name)?))
        });
    for (title, speed, accuracy, rows) in ours.chain(theirs) {
        let ms = middle(rows.values().map(|r| r.features_ms).collect());
        let _ = write!(out, "| {title} | {speed} | {accuracy} | {ms:.0} |");
        for zoom in ZOOMS {
            let f = Figures::of(of_cell(rows, (zoom, Condition::Clean)).map(|(_, r)| r));
            let _ = write!(
                out,
                " {} | {} |",
                share(f.successes, f.pairs),
                px(f.median_px)
            );
        }
        for zoom in ZOOMS {
            let all = rows.iter().filter(|(id, _)| id.scene.zoom == zoom);
            let f = Figures::of(all.map(|(_, r)| r));
            let _ = write!(out, " {} |", share(f.successes, f.pairs));
        }
        out.push('\n');
    }
    out
}

/// Every cell, with every method.
pub fn all_cells(methods: &Methods) -> String {
    let mut out = String::new();
    let precise = methods.get(PRECISE);
    let compared: BTreeMap<&str, Vec<Comparison>> = settings(methods)
        .filter_map(|(s, rows)| Some((s.name, compare(rows, precise?))))
        .collect();
    for cell in cells() {
        let _ = write!(
            out,
            "### {}:1 {}\n\n| method | pairs | < 3 px | < 0.5 px | median px | 90 % px | worst answer px | rough / misleading | \
             inliers | features | nearer than precise | lost / won | verdict |\n|---|---|---|---|---|---|---|---|---|---|---|---|---|\n",
            cell.0,
            cell.1.name()
        );
        let ours = settings(methods).map(|(s, rows)| (s.name, s.name, rows));
        for (name, title, rows) in ours.chain(peers(methods)) {
            let f = Figures::of(of_cell(rows, cell).map(|(_, r)| r));
            if f.pairs == 0 {
                continue;
            }
            let comparison = compared
                .get(name)
                .and_then(|all| all.iter().find(|c| c.cell == cell));
            let paired = comparison.map_or("| |".into(), |c| {
                format!(
                    "{:.2} | {} / {} | {}",
                    c.nearer,
                    c.losses,
                    c.wins,
                    c.verdict()
                )
            });
            let _ = writeln!(
                out,
                "| {title} | {} | {} | {} | {} | {} | {} | {} / {} | {} | {} / {} | {paired} |",
                f.pairs,
                share(f.successes, f.pairs),
                share(f.within_half_px, f.pairs),
                px(f.median_px),
                px(f.p90_px),
                px(f.worst_px),
                f.rough,
                f.misleading,
                f.inliers,
                f.features[0],
                f.features[1],
            );
        }
        out.push('\n');
    }
    out
}

/// The pairs in which a setting of ours fails and OpenCV's precise SIFT does not, at most so many.
pub fn lost_pairs(methods: &Methods, name: &str, at_most: usize) -> String {
    let (Some(ours), Some(precise)) = (methods.get(name), methods.get(PRECISE)) else {
        return String::new();
    };
    let lost: Vec<(&PairId, &Row, &Row)> = ours
        .iter()
        .filter_map(|(id, row)| Some((id, row, precise.get(id)?)))
        .filter(|(_, row, their)| !row.success() && their.success())
        .collect();
    let won = ours
        .iter()
        .filter(|(id, row)| row.success() && precise.get(id).is_some_and(|p| !p.success()))
        .count();
    let mut out = format!(
        "`{name}` fails in {} pairs in which precise succeeds, and succeeds in {won} in which precise fails.\n\n",
        lost.len()
    );
    if lost.is_empty() {
        return out;
    }
    out.push_str("| pair | ours | matches | precise px | its inliers |\n|---|---|---|---|---|\n");
    for (id, row, their) in lost.iter().take(at_most) {
        let _ = writeln!(
            out,
            "| {id} | {} | {} | {} | {} |",
            row.reason
                .clone()
                .unwrap_or_else(|| format!("{} px off", px(row.error_or_infinite()))),
            row.matches,
            px(their.error_or_infinite()),
            their.inliers
        );
    }
    if lost.len() > at_most {
        let _ = writeln!(out, "\nAnd {} more.", lost.len() - at_most);
    }
    out
}

/// What each of our settings is.
pub fn legend() -> String {
    let mut out = String::new();
    for s in &SETTINGS {
        let _ = writeln!(out, "- `{}`: {}.", s.name, s.says);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::comparison::tests::methods;
    use super::*;

    #[test]
    fn a_sure_pair_that_is_lost_is_named() {
        let m = methods(&[0.1, f64::INFINITY, f64::INFINITY], &[0.1, 0.1, 9.0]);
        let (lost, sure) = sure_pairs_lost(&m, &m["2000"]);
        assert_eq!(sure, 2);
        assert_eq!(lost[0].to_string(), "1-clean-001");
        assert!(lost_pairs(&m, "2000", 10).contains("| 1-clean-001 |"));
    }

    #[test]
    fn every_table_has_as_many_columns_in_each_line() {
        let m = methods(&[0.1; 12], &[0.1; 12]);
        for text in [
            summary(&m),
            fast_modes(&m),
            aims(&m),
            table_one(&m),
            all_cells(&m),
        ] {
            let mut columns = None;
            for line in text.lines() {
                let bars = line.matches('|').count();
                if bars == 0 {
                    columns = None;
                } else {
                    assert_eq!(*columns.get_or_insert(bars), bars, "{line}");
                }
            }
        }
    }
}
