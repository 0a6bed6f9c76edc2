//! The parts of OME-XML that say where pixels are.
//!
//! In: the text. Out: [`Ome`]: images, their extents, and the pages of their planes. Everything
//! else is passed over, annotations of others in particular. Read forward; a document type and
//! entities of its own are never expanded. Numbers are not trusted here, only read.

use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};

use crate::error::Error;

/// A document.
#[derive(Debug, Default)]
pub(super) struct Ome {
    /// The UUID of the file the document is in.
    pub(super) uuid: Option<String>,
    /// The file that holds the real document, where this one only names it.
    pub(super) companion: Option<String>,
    pub(super) images: Vec<Image>,
}

/// An image: voxels along X Y Z C T.
#[derive(Debug, Default)]
pub(super) struct Image {
    pub(super) id: String,
    pub(super) name: String,
    pub(super) sizes: [u64; 5],
    dimension_order: String,
    /// Edge lengths along x, y, z and their units, as written.
    pub(super) physical: [Option<(String, Option<String>)>; 3],
    /// Samples of a pixel of the first channel; 0 if not said.
    pub(super) samples: u64,
    pub(super) tiff_data: Vec<TiffData>,
}

/// Pages that hold planes, in order.
#[derive(Debug)]
pub(super) struct TiffData {
    /// Z, C, T of the first.
    pub(super) first: [u64; 3],
    /// Number of the first page.
    pub(super) ifd: u64,
    /// Number of pages; `None` for all that follow.
    pub(super) count: Option<u64>,
    /// The file they are in; `None` for the file of the document.
    pub(super) file: Option<FileName>,
}

/// How a document tells a file.
#[derive(Debug, Default)]
pub(super) struct FileName {
    pub(super) name: String,
    pub(super) uuid: Option<String>,
}

impl Image {
    /// Name and ID for messages.
    pub(super) fn label(&self) -> String {
        match self.name.as_str() {
            "" => self.id.clone(),
            name => format!("{name} ({})", self.id),
        }
    }

    /// Which of Z, C, T (0, 1, 2) varies fastest, second and slowest from page to page.
    pub(super) fn order(&self, name: &str) -> Result<[usize; 3], Error> {
        Ok(match self.dimension_order.as_str() {
            "XYZCT" => [0, 1, 2],
            "XYZTC" => [0, 2, 1],
            "XYCZT" => [1, 0, 2],
            "XYCTZ" => [1, 2, 0],
            "XYTZC" => [2, 0, 1],
            "XYTCZ" => [2, 1, 0],
            other => {
                return Err(Error::invalid(
                    name,
                    format!("the OME-XML says DimensionOrder '{other}', which is not known"),
                ));
            }
        })
    }
}

/// Reads a document.
pub(super) fn parse(text: &[u8]) -> Result<Ome, String> {
    let text = String::from_utf8_lossy(text);
    let text = text
        .trim_start_matches('\u{feff}')
        .trim_end_matches(['\0', ' ', '\n', '\r']);
    let mut reader = Reader::from_str(text);
    let mut ome = Ome::default();
    // Inside annotations other vocabularies may use the same words.
    let mut annotations = 0_usize;
    let mut in_uuid = false;
    loop {
        let event = reader.read_event().map_err(|e| e.to_string())?;
        let opens = matches!(event, Event::Start(_));
        match event {
            Event::Start(element) | Event::Empty(element) => {
                let name = element.local_name();
                if name.as_ref() == "StructuredAnnotations" {
                    annotations += usize::from(opens);
                } else if annotations == 0 {
                    in_uuid = opens && name.as_ref() == "UUID";
                    ome.element(&element)?;
                }
            }
            Event::Text(text) if in_uuid => {
                if let Some(file) = ome.last_data().and_then(|data| data.file.as_mut()) {
                    file.uuid = Some(text.into_inner().trim().to_string());
                }
            }
            Event::End(element) => {
                in_uuid = false;
                if element.local_name().as_ref() == "StructuredAnnotations" {
                    annotations = annotations.saturating_sub(1);
                }
            }
            Event::Eof => break,
            _ => {}
        }
    }
    for image in &mut ome.images {
        // Without the element, planes are the pages in order.
        if image.tiff_data.is_empty() {
            image.tiff_data.push(TiffData {
                first: [0; 3],
                ifd: 0,
                count: None,
                file: None,
            });
        }
    }
    Ok(ome)
}

impl Ome {
    fn last_data(&mut self) -> Option<&mut TiffData> {
        self.images.last_mut()?.tiff_data.last_mut()
    }

    fn element(&mut self, element: &BytesStart<'_>) -> Result<(), String> {
        let text = |key: &str| attribute(element, key);
        let number = |key: &str| -> Result<Option<u64>, String> {
            let text = attribute(element, key)?;
            text.map(|text| {
                text.trim()
                    .parse()
                    .map_err(|_| format!("{key} is '{text}', expected a count"))
            })
            .transpose()
        };
        match element.local_name().as_ref() {
            "OME" => self.uuid = text("UUID")?,
            "BinaryOnly" => self.companion = text("MetadataFile")?,
            "Image" => self.images.push(Image {
                id: text("ID")?.unwrap_or_default(),
                name: text("Name")?.unwrap_or_default(),
                ..Image::default()
            }),
            "Pixels" => {
                let Some(image) = self.images.last_mut() else {
                    return Ok(());
                };
                for (size, key) in image
                    .sizes
                    .iter_mut()
                    .zip(["SizeX", "SizeY", "SizeZ", "SizeC", "SizeT"])
                {
                    *size = number(key)?.ok_or_else(|| format!("{key} is missing"))?;
                }
                image.dimension_order = text("DimensionOrder")?.unwrap_or_default();
                for (physical, axis) in image.physical.iter_mut().zip(["X", "Y", "Z"]) {
                    let size = text(&format!("PhysicalSize{axis}"))?;
                    let unit = text(&format!("PhysicalSize{axis}Unit"))?;
                    *physical = size.map(|size| (size, unit));
                }
            }
            "Channel" => {
                if let Some(image) = self.images.last_mut()
                    && image.samples == 0
                {
                    image.samples = number("SamplesPerPixel")?.unwrap_or(1);
                }
            }
            "TiffData" => {
                let Some(image) = self.images.last_mut() else {
                    return Ok(());
                };
                let ifd = number("IFD")?;
                // Pages without a number of them: one, if the first is said, else all.
                let count = number("PlaneCount")?.or(ifd.map(|_| 1));
                image.tiff_data.push(TiffData {
                    first: [
                        number("FirstZ")?.unwrap_or(0),
                        number("FirstC")?.unwrap_or(0),
                        number("FirstT")?.unwrap_or(0),
                    ],
                    ifd: ifd.unwrap_or(0),
                    count,
                    file: None,
                });
            }
            "UUID" => {
                let name = text("FileName")?;
                if let (Some(data), Some(name)) = (self.last_data(), name) {
                    data.file = Some(FileName { name, uuid: None });
                }
            }
            _ => {}
        }
        Ok(())
    }
}

/// The value of an attribute.
fn attribute(element: &BytesStart<'_>, key: &str) -> Result<Option<String>, String> {
    for attribute in element.attributes() {
        let attribute = attribute.map_err(|e| e.to_string())?;
        if attribute.key.local_name().as_ref() == key {
            let value = attribute
                .normalized_value(quick_xml::XmlVersion::Implicit1_0)
                .map_err(|e| e.to_string())?;
            return Ok(Some(value.into_owned()));
        }
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_files_and_sizes_are_found_under_any_prefix() {
        let text = r#"<?xml version="1.0" encoding="UTF-8"?>
            <!-- a comment --><o:OME xmlns:o="x" UUID="urn:uuid:a"><o:Image ID="Image:0" Name="a &amp; b">
            <o:Pixels DimensionOrder="XYZCT" Type="uint8" SizeX="3" SizeY="4" SizeZ="5" SizeC="2" SizeT="1"
              PhysicalSizeX="0.5" PhysicalSizeXUnit="&#181;m"><o:Channel ID="c" SamplesPerPixel="1"/>
            <o:TiffData FirstC="1" IFD="3"><o:UUID FileName="b.tif"> urn:uuid:b </o:UUID></o:TiffData>
            </o:Pixels></o:Image><o:StructuredAnnotations><Image ID="no"/></o:StructuredAnnotations></o:OME>"#;
        let ome = parse(text.as_bytes()).unwrap();
        assert_eq!(ome.uuid.as_deref(), Some("urn:uuid:a"));
        assert_eq!(ome.images.len(), 1);
        let image = &ome.images[0];
        assert_eq!(image.label(), "a & b (Image:0)");
        assert_eq!(image.sizes, [3, 4, 5, 2, 1]);
        assert_eq!(
            image.physical[0],
            Some(("0.5".into(), Some("\u{b5}m".into())))
        );
        let data = &image.tiff_data[0];
        assert_eq!((data.first, data.ifd, data.count), ([0, 1, 0], 3, Some(1)));
        let file = data.file.as_ref().unwrap();
        assert_eq!(
            (file.name.as_str(), file.uuid.as_deref()),
            ("b.tif", Some("urn:uuid:b"))
        );
    }

    #[test]
    fn entities_of_a_document_are_not_expanded() {
        let text = r#"<!DOCTYPE x [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]>
            <OME><Image ID="&b;" Name="x"/></OME>"#;
        assert!(parse(text.as_bytes()).is_err());
    }
}
