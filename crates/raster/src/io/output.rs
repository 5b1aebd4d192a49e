//! Writing results so that a file is either whole or not there.
//!
//! Every output is first written beside its target, and all of them are renamed together at the
//! end; a failure or an interrupt before that leaves nothing behind.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use tempfile::TempPath;

use crate::error::{Error, Result};

/// Unfinished files of this process, for [`remove_unfinished`].
static UNFINISHED: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// Other threads can neither begin nor finish an output while this lives.
#[derive(Debug)]
#[must_use = "outputs may begin again once this is dropped"]
pub struct NoOutputs {
    _unfinished: MutexGuard<'static, Vec<PathBuf>>,
}

/// Delete the unfinished outputs of this process: what an interrupt handler calls before it exits.
pub fn remove_unfinished() -> NoOutputs {
    let mut paths = unfinished();
    for path in paths.drain(..) {
        // Best effort: the process is about to end.
        let _ = std::fs::remove_file(path);
    }
    NoOutputs { _unfinished: paths }
}

fn unfinished() -> MutexGuard<'static, Vec<PathBuf>> {
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Outputs that wait to be renamed into place.
#[derive(Debug, Default)]
pub struct Outputs {
    staged: Vec<(TempPath, PathBuf)>,
}

impl Outputs {
    /// Write one output beside `target`. A target that exists and is no regular file (a pipe,
    /// `/dev/stdout`) is written directly.
    ///
    /// # Errors
    /// [`Error::Write`] naming the target; a directory is refused.
    pub fn write(
        &mut self,
        target: &Path,
        content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> Result<()> {
        let fail = |source| Error::Write { path: target.to_owned(), source };
        match std::fs::metadata(target) {
            Ok(meta) if meta.is_dir() => {
                return Err(fail(io::Error::new(io::ErrorKind::IsADirectory, "it is a directory")));
            }
            Ok(meta) if !meta.is_file() => {
                let mut writer = BufWriter::new(File::create(target).map_err(fail)?);
                content(&mut writer).and_then(|()| writer.flush()).map_err(fail)?;
                return Ok(());
            }
            _ => {}
        }
        // A symbolic link keeps pointing where it did: the file behind it is replaced.
        let target = &behind_links(target);
        let folder = match target.parent() {
            Some(p) if !p.as_os_str().is_empty() => p,
            _ => Path::new("."),
        };
        let name = target.file_name().unwrap_or_default().to_string_lossy();
        let mut builder = tempfile::Builder::new();
        let prefix = format!(".{name}.");
        builder.prefix(&prefix).suffix(".part");
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            // As for any new file: the process's umask is applied to this.
            builder.permissions(std::fs::Permissions::from_mode(0o666));
        }
        let mut listed = unfinished();
        let file = builder.tempfile_in(folder).map_err(|e| {
            // Without the name of the file beside the target, which nobody asked for.
            let text = e.to_string();
            let text = text.split(" at path ").next().unwrap_or_default();
            fail(io::Error::new(e.kind(), text))
        })?;
        let (file, path) = file.into_parts();
        listed.push(path.to_path_buf());
        drop(listed);
        let mut writer = BufWriter::with_capacity(1 << 18, file);
        content(&mut writer).and_then(|()| writer.flush()).map_err(fail)?;
        self.staged.push((path, target.clone()));
        Ok(())
    }

    /// Move every output into its place.
    ///
    /// # Errors
    /// [`Error::Write`] naming the first that could not be moved.
    pub fn commit(self) -> Result<()> {
        for (path, target) in self.staged {
            let staged = path.to_path_buf();
            let mut listed = unfinished();
            path.persist(&target).map_err(|e| Error::Write { path: target, source: e.error })?;
            listed.retain(|p| *p != staged);
        }
        Ok(())
    }
}

/// The file that a path stands for, there or not yet.
fn behind_links(path: &Path) -> PathBuf {
    if let Ok(file) = std::fs::canonicalize(path) {
        return file;
    }
    let mut file = path.to_owned();
    // As many as the kernel follows; a circle of links ends as one of them.
    for _ in 0..40 {
        let Ok(link) = std::fs::read_link(&file) else { break };
        file = file.parent().unwrap_or(Path::new("")).join(link);
    }
    file
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = std::fs::read_dir(folder).expect("a folder");
        let mut names: Vec<String> = entries
            .map(|e| e.expect("readable").file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn outputs_appear_together_or_not_at_all() {
        let folder = tempfile::tempdir().expect("a folder");
        let (a, b) = (folder.path().join("a.json"), folder.path().join("b.json"));
        std::fs::write(&a, "old").expect("writable");
        let mut outputs = Outputs::default();
        outputs.write(&a, |w| w.write_all(b"new")).expect("writable");
        assert_eq!(std::fs::read_to_string(&a).expect("still there"), "old");
        outputs.write(&b, |w| w.write_all(b"b")).expect("writable");
        outputs.commit().expect("renamed");
        assert_eq!(std::fs::read_to_string(&a).expect("there"), "new");
        assert_eq!(names(folder.path()), ["a.json", "b.json"]);
    }

    #[test]
    fn a_failure_leaves_nothing_behind() {
        let folder = tempfile::tempdir().expect("a folder");
        let mut outputs = Outputs::default();
        outputs.write(&folder.path().join("a"), |w| w.write_all(b"x")).expect("writable");
        let failed = outputs.write(&folder.path().join("b"), |_| Err(io::Error::other("full")));
        assert!(failed.expect_err("refused").to_string().contains("full"));
        drop(outputs);
        assert!(names(folder.path()).is_empty(), "{:?}", names(folder.path()));
    }

    #[test]
    #[cfg(unix)]
    fn a_link_keeps_pointing_where_it_did() {
        let folder = tempfile::tempdir().expect("a folder");
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("old"), "old").expect("writable");
        for (link, to) in [("a", "old"), ("b", "new"), ("c", "b2"), ("b2", "later")] {
            std::os::unix::fs::symlink(to, at(link)).expect("a link");
        }
        let mut outputs = Outputs::default();
        for link in ["a", "b", "c"] {
            outputs.write(&at(link), |w| w.write_all(b"x")).expect("writable");
        }
        outputs.commit().expect("renamed");
        for file in ["old", "new", "later"] {
            assert_eq!(std::fs::read_to_string(at(file)).expect("there"), "x");
        }
        assert!(["a", "b", "c", "b2"].into_iter().all(|l| at(l).is_symlink()));
    }

    #[test]
    fn a_folder_that_is_not_there_is_named_as_the_user_did() {
        let folder = tempfile::tempdir().expect("a folder");
        let target = folder.path().join("none").join("a");
        let error = Outputs::default().write(&target, |_| Ok(())).expect_err("refused").to_string();
        assert!(error.ends_with("a: No such file or directory (os error 2)"), "{error}");
    }

    #[test]
    fn a_directory_is_refused_by_name() {
        let folder = tempfile::tempdir().expect("a folder");
        let error = Outputs::default().write(folder.path(), |_| Ok(())).expect_err("refused");
        assert!(error.to_string().contains("directory"), "{error}");
    }
}
