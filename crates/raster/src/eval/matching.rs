//! Which prediction belongs to which ground-truth pose: by id, or BOP's way for files with several
//! scored estimates and several instances.

use std::collections::BTreeMap;
use std::hash::BuildHasher;

use foldhash::fast::FixedState;
use hashbrown::HashTable;

use crate::error::{Error, Place, Result, quoted, shortened};
use crate::io::table::{PoseTable, Strings, Target};
use crate::rotation;

/// Result of matching two tables.
#[derive(Debug, Clone, Default)]
pub struct Matching {
    /// Ground-truth row and prediction row, in the order of the ground truth.
    pub pairs: Vec<(u32, u32)>,
    /// What the user should know.
    pub warnings: Vec<String>,
}

/// Pair the rows of `predictions` with those of `gt`.
///
/// Tables with plain ids are joined by id; each id may occur once. If both are BOP files, the
/// estimates of each (scene, image, object) are taken by descending score, as many as there are
/// instances, and each goes to the nearest free instance (translation first, then angle). If only
/// one is a BOP file, its image numbers are the ids.
///
/// # Errors
/// A duplicate id ([`Error::Malformed`], naming both lines), no id in common
/// ([`Error::Mismatch`]).
pub fn match_tables(predictions: &PoseTable, gt: &PoseTable) -> Result<Matching> {
    match (&predictions.targets, &gt.targets) {
        (Some(p), Some(g)) => match_bop(predictions, p, gt, g),
        (None, None) => by_id(predictions, &predictions.ids, None, gt, &gt.ids),
        (Some(p), None) => {
            by_id(predictions, &image_ids(p), predictions.scores.as_deref(), gt, &gt.ids)
        }
        (None, Some(g)) => by_id(predictions, &predictions.ids, None, gt, &image_ids(g)),
    }
}

/// Image numbers as ids where that is enough, else `scene/image/object`.
fn image_ids(targets: &[Target]) -> Strings {
    let single =
        targets.iter().all(|t| (t.scene, t.object) == (targets[0].scene, targets[0].object));
    let mut ids = Strings::default();
    for t in targets {
        if single {
            ids.push(&t.image.to_string());
        } else {
            ids.push(&format!("{}/{}/{}", t.scene.unwrap_or(0), t.image, t.object));
        }
    }
    ids
}

fn by_id(
    predictions: &PoseTable,
    predicted_ids: &Strings,
    scores: Option<&[f64]>,
    gt: &PoseTable,
    gt_ids: &Strings,
) -> Result<Matching> {
    const FREE: u32 = u32::MAX;
    let hasher = FixedState::with_seed(0);
    let hash = |id: &str| hasher.hash_one(id);
    let index = || {
        let mut index: HashTable<u32> = HashTable::with_capacity(gt_ids.len());
        for (row, id) in gt_ids.iter().enumerate() {
            let equal = |&r: &u32| gt_ids.get(r as usize) == id;
            if let Some(&first) = index.find(hash(id), equal) {
                return Err(duplicate(gt, row, first as usize, id));
            }
            index.insert_unique(hash(id), row as u32, |&r| hash(gt_ids.get(r as usize)));
        }
        Ok(index)
    };
    // Ids that ascend hold no duplicate, and files in the same order need no index.
    let mut known = if ascending(gt_ids) { None } else { Some(index()?) };
    let mut prediction_of = vec![FREE; gt_ids.len()];
    let mut unknown: Vec<u32> = Vec::new();
    for (row, id) in predicted_ids.iter().enumerate() {
        // Files are mostly in the same order: look there before hashing.
        let gt_row = if row < gt_ids.len() && gt_ids.get(row) == id {
            Some(row)
        } else {
            let index = match &mut known {
                Some(index) => index,
                None => known.insert(index()?),
            };
            index.find(hash(id), |&r| gt_ids.get(r as usize) == id).map(|&r| r as usize)
        };
        let Some(gt_row) = gt_row else {
            unknown.push(row as u32);
            continue;
        };
        let slot = &mut prediction_of[gt_row];
        match scores {
            _ if *slot == FREE => *slot = row as u32,
            Some(scores) if scores[row] > scores[*slot as usize] => *slot = row as u32,
            Some(_) => {}
            None => return Err(duplicate(predictions, row, *slot as usize, id)),
        }
    }
    let mut matching = Matching::default();
    matching.pairs.reserve(gt_ids.len().min(predicted_ids.len()));
    let mut missing = Vec::new();
    for (row, &p) in prediction_of.iter().enumerate() {
        if p == FREE {
            missing.push(row);
        } else {
            matching.pairs.push((row as u32, p));
        }
    }
    if matching.pairs.is_empty() {
        return Err(Error::Mismatch {
            place: Place::file(&predictions.name).column("id"),
            message: format!(
                "no id is also in {}: found ids like {}, expected ids like {}",
                gt.name,
                quoted(predicted_ids.get(0).as_bytes()),
                quoted(gt_ids.get(0).as_bytes())
            ),
        });
    }
    if !unknown.is_empty() {
        let place = predictions.place(unknown[0] as usize, "id");
        let names = examples(unknown.iter().map(|&r| predicted_ids.get(r as usize)), unknown.len());
        matching.warnings.push(format!(
            "{place}: {} of {} predicted ids are not in {} and were ignored: {names}",
            unknown.len(),
            predicted_ids.len(),
            gt.name
        ));
    }
    if !missing.is_empty() {
        let names = examples(missing.iter().map(|&r| gt_ids.get(r)), missing.len());
        matching.warnings.push(missing_warning(predictions, missing.len(), gt_ids.len(), &names));
    }
    Ok(matching)
}

/// Each id is longer than the one before, or as long and greater: numbers that count up.
fn ascending(ids: &Strings) -> bool {
    let mut before = "";
    ids.iter().all(|id| {
        let up = (before.len(), before) < (id.len(), id);
        before = id;
        up
    })
}

fn missing_warning(predictions: &PoseTable, missing: usize, n_gt: usize, names: &str) -> String {
    format!(
        "{}: {missing} of {n_gt} ground-truth poses have no prediction: {names}; means are over the \
         matched ones, recalls count the missing ones as wrong",
        predictions.name
    )
}

fn examples<'a>(names: impl Iterator<Item = &'a str>, count: usize) -> String {
    let mut shown = names.take(5).map(|n| shortened(n.as_bytes())).collect::<Vec<_>>().join(", ");
    if count > 5 {
        shown.push_str(", …");
    }
    shown
}

fn duplicate(table: &PoseTable, row: usize, first: usize, id: &str) -> Error {
    let seen = table.line(first).map_or(String::new(), |l| format!(" (first on line {l})"));
    Error::malformed(
        table.place(row, "id"),
        format!("a duplicate id {}{seen}", quoted(id.as_bytes())),
        "every id once",
    )
}

type Groups = BTreeMap<Target, Vec<u32>>;

/// Rows by target, in the order of the file within a target.
fn group(targets: &[Target], scene: Option<u32>) -> Groups {
    let mut groups = Groups::new();
    for (row, t) in targets.iter().enumerate() {
        let t = Target { scene: t.scene.or(scene), ..*t };
        groups.entry(t).or_default().push(row as u32);
    }
    groups
}

/// The one scene of a table, if all rows agree.
fn only_scene(targets: &[Target]) -> Option<u32> {
    let first = targets.first()?.scene?;
    targets.iter().all(|t| t.scene == Some(first)).then_some(first)
}

fn match_bop(
    predictions: &PoseTable,
    predicted: &[Target],
    gt: &PoseTable,
    actual: &[Target],
) -> Result<Matching> {
    let unknown_scene = |targets: &[Target]| targets.iter().any(|t| t.scene.is_none());
    if unknown_scene(actual) && only_scene(predicted).is_none() && !unknown_scene(predicted) {
        return Err(Error::Mismatch {
            place: Place::file(&gt.name),
            message: format!(
                "the scene of this file is unknown and {} holds several: name the folder after the \
                 scene (000002/scene_gt.json), or give the folder of all scenes",
                predictions.name
            ),
        });
    }
    let estimates = group(predicted, only_scene(actual));
    let instances = group(actual, only_scene(predicted));
    let mut matching = Matching::default();
    for (target, gt_rows) in &instances {
        let Some(rows) = estimates.get(target) else { continue };
        let ranked = top_by_score(rows, predictions.scores.as_deref(), gt_rows.len());
        let mut free = gt_rows.clone();
        for p in ranked {
            let cost = |g: u32| {
                let (a, b) = (&predictions.poses[p as usize], &gt.poses[g as usize]);
                (a.translation.distance(b.translation), rotation::angle(a.rotation, b.rotation))
            };
            let nearest = (0..free.len()).min_by(|&i, &j| {
                cost(free[i]).partial_cmp(&cost(free[j])).unwrap_or(std::cmp::Ordering::Equal)
            });
            if let Some(k) = nearest {
                matching.pairs.push((free.remove(k), p));
            }
        }
    }
    matching.pairs.sort_unstable();
    if matching.pairs.is_empty() {
        return Err(Error::Mismatch {
            place: Place::file(&predictions.name).column("im_id"),
            message: format!(
                "no (scene, image, object) id is also in {}: found {}, expected ids like {}",
                gt.name,
                predictions.id(0),
                gt.id(0)
            ),
        });
    }
    let without: Vec<u32> = estimates
        .iter()
        .filter(|(target, _)| !instances.contains_key(target))
        .flat_map(|(_, rows)| rows.iter().copied())
        .collect();
    if !without.is_empty() {
        let names: Vec<String> =
            without.iter().take(5).map(|&r| predictions.id(r as usize).into_owned()).collect();
        matching.warnings.push(format!(
            "{}: {} of {} estimates are for no ground-truth instance and were ignored: {}",
            predictions.place(without[0] as usize, "im_id"),
            without.len(),
            predicted.len(),
            examples(names.iter().map(String::as_str), without.len())
        ));
    }
    let missing = actual.len() - matching.pairs.len();
    if missing > 0 {
        let mut taken = vec![false; actual.len()];
        for &(g, _) in &matching.pairs {
            taken[g as usize] = true;
        }
        let rows = (0..actual.len()).filter(|&g| !taken[g]);
        let names: Vec<String> = rows.take(5).map(|g| gt.id(g).into_owned()).collect();
        let names = examples(names.iter().map(String::as_str), missing);
        matching.warnings.push(missing_warning(predictions, missing, actual.len(), &names));
    }
    Ok(matching)
}

/// The `count` best rows by score; equal scores in the order of the file (BOP's stable sort).
#[must_use]
pub fn top_by_score(rows: &[u32], scores: Option<&[f64]>, count: usize) -> Vec<u32> {
    let mut ranked = rows.to_vec();
    if let Some(scores) = scores {
        ranked.sort_by(|&a, &b| scores[b as usize].total_cmp(&scores[a as usize]));
    }
    ranked.truncate(count);
    ranked
}

/// Ground-truth rows with their estimates: the groups that BOP matches within.
#[must_use]
pub fn bop_groups(predictions: &PoseTable, gt: &PoseTable) -> Option<Vec<(Vec<u32>, Vec<u32>)>> {
    let (predicted, actual) = (predictions.targets.as_ref()?, gt.targets.as_ref()?);
    let estimates = group(predicted, only_scene(actual));
    let instances = group(actual, only_scene(predicted));
    let scores = predictions.scores.as_deref();
    let groups = instances.into_iter().map(|(target, gt_rows)| {
        let rows = estimates.get(&target).map_or(&[][..], Vec::as_slice);
        let ranked = top_by_score(rows, scores, gt_rows.len());
        (gt_rows, ranked)
    });
    Some(groups.collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::{PoseOptions, parse_poses};

    fn table(text: &str) -> PoseTable {
        parse_poses("x.csv", text.as_bytes().to_vec(), &PoseOptions::default()).expect("sound")
    }

    fn csv(ids: &[&str]) -> PoseTable {
        let rows: Vec<String> = ids.iter().map(|id| format!("{id},1,0,0,0,0,0,1")).collect();
        table(&format!("id,qw,qx,qy,qz,tx,ty,tz\n{}\n", rows.join("\n")))
    }

    fn bop(rows: &[(u32, u32, f64, f64)]) -> PoseTable {
        let line = |&(image, object, score, x): &(u32, u32, f64, f64)| {
            format!("1,{image},{object},{score},1 0 0 0 1 0 0 0 1,{x} 0 1000,-1\n")
        };
        let rows: String = rows.iter().map(line).collect();
        table(&format!("scene_id,im_id,obj_id,score,R,t,time\n{rows}"))
    }

    #[test]
    fn rows_are_joined_by_id() {
        let m = match_tables(&csv(&["c", "x", "a"]), &csv(&["a", "b", "c"])).expect("sound");
        assert_eq!(m.pairs, [(0, 2), (2, 0)]);
        assert!(m.warnings[0].contains("x.csv:3:id: 1 of 3") && m.warnings[0].ends_with(": x"));
        assert!(m.warnings[1].contains("1 of 3 ground-truth poses have no prediction: b"));
    }

    #[test]
    fn duplicates_name_both_lines() {
        let error = match_tables(&csv(&["a", "b", "a"]), &csv(&["a", "b"])).expect_err("twice");
        let text = error.to_string();
        assert!(
            text.starts_with("x.csv:4:id: found a duplicate id 'a' (first on line 2)"),
            "{text}"
        );
        assert!(match_tables(&csv(&["a"]), &csv(&["a", "a"])).is_err());
    }

    #[test]
    fn ids_that_count_up_are_joined_in_any_order() {
        for gt in [["8", "9", "10"], ["10", "9", "8"], ["9", "10", "8"]] {
            for predicted in [["8", "9", "10"], ["10", "8", "9"]] {
                let m = match_tables(&csv(&predicted), &csv(&gt)).expect("sound");
                assert_eq!(m.pairs.len(), 3);
                assert!(m.pairs.iter().all(|&(g, p)| gt[g as usize] == predicted[p as usize]));
            }
            assert!(match_tables(&csv(&["8", "8"]), &csv(&gt)).is_err());
        }
        assert!(match_tables(&csv(&["8"]), &csv(&["8", "9", "9"])).is_err());
    }

    #[test]
    fn no_common_id_is_an_error() {
        let text = match_tables(&csv(&["x"]), &csv(&["a"])).expect_err("disjoint").to_string();
        assert!(text.contains("'x'") && text.contains("'a'"), "{text}");
    }

    #[test]
    fn the_best_score_counts_and_ties_go_to_the_first() {
        let gt = bop(&[(0, 1, 1.0, 0.0), (1, 1, 1.0, 0.0)]);
        let estimates =
            bop(&[(0, 1, 0.2, 5.0), (0, 1, 0.9, 7.0), (0, 1, 0.9, 1.0), (1, 1, 0.1, 2.0)]);
        let m = match_tables(&estimates, &gt).expect("sound");
        assert_eq!(m.pairs, [(0, 1), (1, 3)]);
        let plain = match_tables(&estimates, &csv(&["1", "0"])).expect("images are ids");
        assert_eq!(plain.pairs, [(0, 3), (1, 1)]);
    }

    #[test]
    fn instances_go_to_the_nearest_free_estimate() {
        let gt = bop(&[(0, 1, 1.0, 0.0), (0, 1, 1.0, 500.0), (0, 2, 1.0, 0.0)]);
        let estimates =
            bop(&[(0, 1, 0.5, 510.0), (0, 1, 0.9, 20.0), (0, 1, 0.1, 0.0), (0, 3, 1.0, 0.0)]);
        let m = match_tables(&estimates, &gt).expect("sound");
        assert_eq!(m.pairs, [(0, 1), (1, 0)]);
        assert_eq!(m.warnings.len(), 2);
        assert!(m.warnings[1].contains("1 of 3") && m.warnings[1].contains("1/0/2"));
    }

    #[test]
    fn a_table_matches_itself() {
        let t = bop(&[(0, 1, 0.5, 0.0), (0, 1, 0.9, 9.0), (3, 2, 0.9, 9.0)]);
        assert_eq!(match_tables(&t, &t).expect("itself").pairs, [(0, 0), (1, 1), (2, 2)]);
    }
}
