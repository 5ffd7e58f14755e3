//! Hex vectors of the protocol pages, read by name.

/// Bytes of the block "```hex NAME" of a page.
pub(crate) fn vector(page: &str, name: &str) -> Vec<u8> {
    let (_, bytes) = all(page)
        .into_iter()
        .find(|(found, _)| found == name)
        .unwrap_or_else(|| panic!("the page has no vector {name}"));
    bytes
}

/// Every named block of a page, in the page's order.
pub(crate) fn all(page: &str) -> Vec<(String, Vec<u8>)> {
    let mut found = Vec::new();
    for block in page.split("```hex ").skip(1) {
        let (name, rest) = block.split_once('\n').expect("a name ends its line");
        let (hex, _) = rest.split_once("```").expect("a block is closed");
        let digits: String = hex.split_whitespace().collect();
        let bytes = (0..digits.len())
            .step_by(2)
            .map(|at| u8::from_str_radix(&digits[at..at + 2], 16).expect("hex digits"))
            .collect();
        found.push((name.trim().to_owned(), bytes));
    }
    found
}

/// The robot's page.
pub(crate) const HSES_PAGE: &str = include_str!("../../docs/protocols/hses.md");
/// The camera's page.
pub(crate) const CAMERA_PAGE: &str = include_str!("../../docs/protocols/camera.md");
