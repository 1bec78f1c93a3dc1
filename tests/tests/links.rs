//! Links from one document to another, and to pictures.

use std::fs;
use std::path::{Path, PathBuf};

fn documents(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() && !name.starts_with('.') && name != "target" && name != "runs" {
            documents(&path, found);
        } else if name.ends_with(".md") {
            found.push(path);
        }
    }
}

#[test]
fn every_relative_link_of_the_documents_leads_somewhere() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let mut found = Vec::new();
    documents(root, &mut found);
    for document in &found {
        let mut followed = 0;
        let text = fs::read_to_string(document).unwrap();
        for link in text.split("](").skip(1).filter_map(|rest| rest.split(')').next()) {
            let path = link.split('#').next().unwrap();
            if path.is_empty() || path.contains("://") || path.contains(' ') {
                continue;
            }
            assert!(document.parent().unwrap().join(path).exists(), "{}: {link}", document.display());
            followed += 1;
        }
        // A reader of links that finds none would pass everything.
        let least = if *document == root.join("README.md") { 11 } else { 0 };
        assert!(followed >= least, "{followed} links in {}", document.display());
    }
    for known in ["README.md", "CHANGELOG.md", "shared/PROTOCOL.md", "optimiser/guide/commands.md"] {
        assert!(found.contains(&root.join(known)), "{known} is not among the documents");
    }
}

#[test]
fn readme_is_short() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let lines = fs::read_to_string(root.join("README.md")).unwrap().lines().count();
    assert!(lines <= 150, "{lines} lines: what somebody reads who has begun belongs into optimiser/guide");
}
