//! The machine-readable result; `docs/json.md` documents every key.

use crate::eval::Evaluation;

/// The evaluation as indented JSON with a newline at the end.
///
/// # Panics
/// Never: the keys of all maps are strings, and nothing else can fail in memory.
#[must_use]
pub fn json(e: &Evaluation) -> String {
    let mut out = serde_json::to_string_pretty(e)
        .expect("an evaluation has string keys and no failing types");
    out.push('\n');
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::fixture::Fixture;

    #[test]
    fn absent_values_are_left_out() {
        for f in Fixture::all() {
            let out = json(&f.evaluation);
            assert!(out.ends_with("}\n"));
            assert!(!out.contains("null"), "{out}");
            let back: serde_json::Value = serde_json::from_str(&out).unwrap();
            assert_eq!(back["schema"], crate::eval::SCHEMA);
        }
    }
}
