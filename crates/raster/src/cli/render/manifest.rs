//! `manifest.json`: how the pictures of a folder were drawn, and which they are. With it a run goes
//! on where another stopped, and never mixes pictures that were drawn in different ways.

use std::collections::{BTreeMap, HashSet};
use std::io::ErrorKind;
use std::path::{Component, Path};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::error::{Error, Place, Result};
use crate::io::output::Outputs;

/// Its name in the folder.
pub(super) const NAME: &str = "manifest.json";
const SCHEMA: &str = "dronepose-render/1";

/// What `manifest.json` holds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Manifest {
    pub(super) schema: String,
    /// Version of dronepose.
    pub(super) version: String,
    /// The last command line.
    pub(super) command: Vec<String>,
    /// All files listed are there.
    pub(super) complete: bool,
    /// Everything the pixels depend on.
    pub(super) settings: serde_json::Map<String, Value>,
    /// What the numbers in the files mean, by folder and ending.
    pub(super) encoding: BTreeMap<String, BTreeMap<String, String>>,
    /// Files of many frames.
    pub(super) sheets: Vec<String>,
    /// In the order of the poses.
    pub(super) frames: Vec<Record>,
}

/// The files of one pose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Record {
    /// Row of the poses, from 0.
    pub(super) row: usize,
    /// Its id.
    pub(super) id: String,
    /// Line in the file, where it has lines.
    pub(super) line: Option<u64>,
    /// Relative to the folder.
    pub(super) files: Vec<String>,
}

impl Manifest {
    pub(super) fn new(command: &[String], settings: serde_json::Map<String, Value>) -> Self {
        Self {
            schema: SCHEMA.to_owned(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            command: command.to_vec(),
            complete: false,
            settings,
            encoding: BTreeMap::new(),
            sheets: Vec::new(),
            frames: Vec::new(),
        }
    }

    /// That of a folder; `None` if it has none.
    ///
    /// # Errors
    /// [`Error::Read`]; [`Error::Malformed`] for a file that is no manifest of ours.
    pub(super) fn read(folder: &Path) -> Result<Option<Self>> {
        let path = folder.join(NAME);
        let bytes = match std::fs::read(&path) {
            Ok(bytes) => bytes,
            Err(e) if matches!(e.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => {
                return Ok(None);
            }
            Err(source) => return Err(Error::Read { path, source }),
        };
        let refuse = |found: String| {
            Error::malformed(
                Place::file(&path.display().to_string()),
                found,
                format!("a manifest {SCHEMA}; choose another --out, or pass --force"),
            )
        };
        let manifest: Self =
            serde_json::from_slice(&bytes).map_err(|e| refuse(format!("something else ({e})")))?;
        if manifest.schema != SCHEMA {
            return Err(refuse(format!("the schema '{}'", manifest.schema)));
        }
        Ok(Some(manifest))
    }

    /// Write it into the folder.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub(super) fn write(&self, folder: &Path) -> Result<()> {
        let mut outputs = Outputs::default();
        outputs.write(&folder.join(NAME), |out| out.write_all(self.text().as_bytes()))?;
        outputs.commit()
    }

    /// As JSON.
    pub(super) fn text(&self) -> String {
        // Strings, numbers and lists: nothing that JSON cannot hold.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }

    /// The first setting in which two runs differ: its name, here, there. What only one of them has
    /// (a background, say) stands in nobody's way.
    pub(super) fn difference(&self, other: &Self) -> Option<(String, String, String)> {
        if self.version != other.version {
            return Some(("version".to_owned(), self.version.clone(), other.version.clone()));
        }
        self.settings.iter().find_map(|(key, a)| differ(key, a, other.settings.get(key)?))
    }

    /// Strike off the files that are not there.
    pub(super) fn keep_files(&mut self, is_there: impl Fn(&str) -> bool) {
        self.sheets.retain(|f| is_there(f));
        for frame in &mut self.frames {
            frame.files.retain(|f| is_there(f));
        }
        self.frames.retain(|frame| !frame.files.is_empty());
    }

    /// Take in the files of an earlier run with the same settings.
    pub(super) fn absorb(&mut self, old: &Self) {
        for (key, value) in &old.settings {
            self.settings.entry(key).or_insert_with(|| value.clone());
        }
        for (layer, endings) in &old.encoding {
            let own = self.encoding.entry(layer.clone()).or_default();
            for (ending, text) in endings {
                own.entry(ending.clone()).or_insert_with(|| text.clone());
            }
        }
        merge(&mut self.sheets, &old.sheets);
        let mut by_row: BTreeMap<usize, Record> =
            self.frames.drain(..).map(|r| (r.row, r)).collect();
        for record in &old.frames {
            match by_row.get_mut(&record.row) {
                Some(own) => merge(&mut own.files, &record.files),
                None => drop(by_row.insert(record.row, record.clone())),
            }
        }
        self.frames.extend(by_row.into_values());
    }

    /// All files listed.
    pub(super) fn files(&self) -> impl Iterator<Item = &str> {
        let frames = self.frames.iter().flat_map(|f| &f.files);
        self.sheets.iter().chain(frames).map(String::as_str)
    }

    /// Delete the files listed, before others take their place.
    pub(super) fn remove_files(&self, folder: &Path) {
        // A list that somebody edited reaches nothing outside the folder.
        let inside =
            |f: &&str| Path::new(f).components().all(|c| matches!(c, Component::Normal(_)));
        for file in self.files().filter(inside) {
            // One that is gone already is fine; one that stays is written over or stays.
            let _ = std::fs::remove_file(folder.join(file));
        }
    }
}

fn merge(own: &mut Vec<String>, more: &[String]) {
    let known: HashSet<String> = own.iter().cloned().collect();
    own.extend(more.iter().filter(|f| !known.contains(*f)).cloned());
    own.sort();
}

fn differ(name: &str, a: &Value, b: &Value) -> Option<(String, String, String)> {
    match (a, b) {
        (Value::Object(a), Value::Object(b)) => {
            let mut keys = a.keys().chain(b.keys().filter(|k| !a.contains_key(*k)));
            keys.find_map(|k| {
                let (a, b) = (a.get(k).unwrap_or(&Value::Null), b.get(k).unwrap_or(&Value::Null));
                differ(&format!("{name}.{k}"), a, b)
            })
        }
        (a, b) => (a != b).then(|| (name.to_owned(), a.to_string(), b.to_string())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn manifest(settings: &Value, files: &[&str]) -> Manifest {
        let mut manifest = Manifest::new(&[], settings.as_object().expect("an object").clone());
        for (row, file) in files.iter().enumerate() {
            let files = vec![(*file).to_owned()];
            manifest.frames.push(Record { row, id: row.to_string(), line: None, files });
        }
        manifest
    }

    #[test]
    fn a_difference_is_named_and_what_is_missing_is_none() {
        let a = manifest(&serde_json::json!({"mode": {"name": "hard"}, "near_m": 1.0}), &[]);
        let b = manifest(&serde_json::json!({"mode": {"name": "dibr", "delta": 7.0}}), &[]);
        let found = a.difference(&b).expect("another mode");
        assert_eq!(found, ("mode.name".into(), "\"hard\"".into(), "\"dibr\"".into()));
        let c = manifest(&serde_json::json!({"near_m": 1.0, "background": null}), &[]);
        assert_eq!(a.difference(&c), None);
        assert!(manifest(&serde_json::json!({"background": "a"}), &[]).difference(&c).is_some());
    }

    #[test]
    fn an_earlier_run_is_taken_in() {
        let mut new = manifest(&serde_json::json!({"a": 1}), &["x/0.png"]);
        let old = manifest(&serde_json::json!({"b": 2}), &["y/0.png", "y/1.png"]);
        new.absorb(&old);
        new.absorb(&old);
        assert_eq!(new.frames.len(), 2);
        assert_eq!(new.frames[0].files, ["x/0.png", "y/0.png"]);
        assert_eq!(new.settings.len(), 2);
        new.keep_files(|f| f == "x/0.png");
        assert_eq!(new.files().collect::<Vec<_>>(), ["x/0.png"]);
    }

    #[test]
    fn it_is_read_as_written_and_nothing_outside_is_deleted() {
        let folder = tempfile::tempdir().expect("a folder");
        let inner = folder.path().join("out");
        std::fs::create_dir(&inner).expect("made");
        assert_eq!(Manifest::read(&inner).expect("none"), None);
        let written = manifest(&serde_json::json!({"f": 0.1}), &["../keep", "gone"]);
        written.write(&inner).expect("written");
        assert_eq!(Manifest::read(&inner).expect("sound"), Some(written.clone()));
        for file in [folder.path().join("keep"), inner.join("gone")] {
            std::fs::write(file, "x").expect("written");
        }
        written.remove_files(&inner);
        assert!(folder.path().join("keep").exists() && !inner.join("gone").exists());
        std::fs::write(inner.join(NAME), "{}").expect("written");
        let text = Manifest::read(&inner).expect_err("refused").to_string();
        assert!(text.contains("pass --force"), "{text}");
    }
}
