//! The table of a campaign: a row for each case, as Parquet.
//!
//! The same campaign is the same bytes, wherever its cases were run: there are no times in it.

use super::{Campaign, CampaignError, Case, Found, Outcome, Status, number};
use parquet::{
    basic::{LogicalType, Repetition, Type as Physical},
    column::writer::ColumnWriter,
    data_type::ByteArray,
    errors::ParquetError,
    file::{metadata::KeyValue, properties::WriterProperties, writer::SerializedFileWriter},
    schema::types::Type,
};
use powderline_shared::plan::SkillParameter;
use powderline_simulator::PHYSICS_VERSION;
use std::{collections::BTreeSet, sync::Arc};

/// What a case that has not been run yet has in the place of a status.
const OPEN: &str = "open";

/// A column; a cell may be empty.
struct Column {
    name: String,
    cells: Cells,
}

enum Cells {
    Numbers(Vec<Option<f64>>),
    Whole(Vec<Option<i64>>),
    Words(Vec<Option<String>>),
}

/// Rows of cases, with what became of each, if it was run.
type Rows<'a> = [(Case<'a>, Option<&'a Outcome>)];

/// The table as a file's bytes; an outcome for each case, none for one that has not been run.
///
/// # Errors
/// [`CampaignError`], about a draw, or by the library that writes Parquet.
pub fn parquet(campaign: &Campaign, outcomes: &[Option<Outcome>]) -> Result<Vec<u8>, CampaignError> {
    let rows: Vec<_> = campaign.cases().zip(outcomes.iter().map(Option::as_ref)).collect();
    let columns = columns(campaign, &rows)?;
    written(campaign, &columns).map_err(|error| CampaignError(format!("the table cannot be made: {error}")))
}

fn columns(campaign: &Campaign, rows: &Rows<'_>) -> Result<Vec<Column>, CampaignError> {
    let words = |name: &str, cell: &dyn Fn(&Case<'_>, Option<&Outcome>) -> Option<String>| {
        let cells = rows.iter().map(|(case, outcome)| cell(case, *outcome)).collect();
        Column { name: name.into(), cells: Cells::Words(cells) }
    };
    let numbers = |name: &str, cell: &dyn Fn(&Found) -> Option<f64>| {
        let cells = rows.iter().map(|(_, outcome)| cell(outcome.as_ref()?.found()?)).collect();
        Column { name: name.into(), cells: Cells::Numbers(cells) }
    };
    let whole = |name: &str, cell: &dyn Fn(&Case<'_>, Option<&Found>) -> Option<i64>| {
        let found = |outcome: &Option<&'_ Outcome>| outcome.and_then(Outcome::found).cloned();
        let cells = rows.iter().map(|(case, outcome)| cell(case, found(outcome).as_ref())).collect();
        Column { name: name.into(), cells: Cells::Whole(cells) }
    };
    let mut columns = vec![
        words("case", &|case, _| Some(case.name.clone())),
        words("bench", &|case, _| Some(case.setting.bench().into())),
        words("powder", &|case, _| case.setting.powder().map(String::from)),
        Column {
            name: "amount_kg".into(),
            cells: Cells::Numbers(rows.iter().map(|(case, _)| case.setting.amount_kg).collect()),
        },
        whole("draw", &|case, _| Some(i64::from(case.setting.draw?) + 1)),
        // Seeds beyond 2^63 - 1 come as what they are modulo 2^64: Parquet's readers have no larger numbers.
        whole("seed", &|case, _| Some(case.seed.cast_signed())),
    ];
    columns.extend(of_powder(campaign, rows)?);
    columns.extend([
        words("status", &|_, outcome| Some(outcome.map_or(OPEN, |o| o.status().name()).into())),
        words("error", &|_, outcome| outcome?.error().map(String::from)),
        numbers("wanted_kg", &|found| Some(found.wanted_kg)),
        numbers("mass_kg", &|found| Some(found.mass_kg)),
        numbers("own_mass_kg", &|found| Some(found.own_mass_kg)),
        numbers("miss", &|found| Some(found.miss)),
        numbers("lost_kg", &|found| Some(found.lost_kg)),
        numbers("loss_m", &|found| Some(found.loss_m)),
        whole("last_epoch", &|_, found| Some(found?.epochs?[0].into())),
        whole("plan_epoch", &|_, found| Some(found?.epochs?[1].into())),
    ]);
    for parameter in SkillParameter::ALL {
        let name = format!("theta_{}", parameter.name().replace(' ', "_"));
        columns.push(numbers(&name, &|found| Some(found.theta[parameter])));
    }
    columns.push(words("plan", &|_, outcome| outcome?.found()?.plan.clone()));
    columns.push(words("key", &|_, outcome| Some(outcome?.key.clone())));
    Ok(columns)
}

/// The numbers of the powder that the campaign changes, `powder.density_kg_m3` and the like.
fn of_powder(campaign: &Campaign, rows: &Rows<'_>) -> Result<Vec<Column>, CampaignError> {
    let file = campaign.file();
    let changed = file.powder.iter().flat_map(|powder| {
        powder.changes.iter().filter(|(_, value)| number(value).is_some()).map(|(key, _)| key.as_str())
    });
    let drawn = file.draws.iter().flat_map(|draws| draws.powder.keys().map(String::as_str));
    let keys: BTreeSet<&str> = changed.chain(drawn).collect();
    let mut columns: Vec<Column> = keys
        .iter()
        .map(|key| Column {
            name: format!("powder.{key}"),
            cells: Cells::Numbers(Vec::with_capacity(rows.len())),
        })
        .collect();
    if columns.is_empty() {
        return Ok(columns);
    }
    for (case, _) in rows {
        let fields = case.setting.powder_fields()?;
        for (key, column) in keys.iter().zip(&mut columns) {
            if let Cells::Numbers(cells) = &mut column.cells {
                cells.push(fields.get(*key).and_then(number));
            }
        }
    }
    Ok(columns)
}

fn written(campaign: &Campaign, columns: &[Column]) -> Result<Vec<u8>, ParquetError> {
    let fields = columns.iter().map(|column| column.kind().map(Arc::new)).collect::<Result<_, _>>()?;
    let schema = Type::group_type_builder("campaign").with_fields(fields).build()?;
    let about =
        [("powderline.campaign", campaign.to_files().0), ("powderline.physics", PHYSICS_VERSION.to_string())];
    let about = about.map(|(key, value)| KeyValue::new(key.to_owned(), value)).to_vec();
    let properties = WriterProperties::builder()
        .set_created_by(format!("powderline {}", env!("CARGO_PKG_VERSION")))
        .set_key_value_metadata(Some(about))
        .build();
    let mut file = SerializedFileWriter::new(Vec::new(), Arc::new(schema), Arc::new(properties))?;
    let mut group = file.next_row_group()?;
    let mut left = columns.iter();
    while let (Some(mut writer), Some(column)) = (group.next_column()?, left.next()) {
        column.write(writer.untyped())?;
        writer.close()?;
    }
    group.close()?;
    file.into_inner()
}

impl Column {
    fn kind(&self) -> Result<Type, ParquetError> {
        let (physical, logical) = match &self.cells {
            Cells::Numbers(_) => (Physical::DOUBLE, None),
            Cells::Whole(_) => (Physical::INT64, None),
            Cells::Words(_) => (Physical::BYTE_ARRAY, Some(LogicalType::String)),
        };
        Type::primitive_type_builder(&self.name, physical)
            .with_repetition(Repetition::OPTIONAL)
            .with_logical_type(logical)
            .build()
    }

    fn write(&self, writer: &mut ColumnWriter<'_>) -> Result<(), ParquetError> {
        match (&self.cells, writer) {
            (Cells::Numbers(cells), ColumnWriter::DoubleColumnWriter(writer)) => {
                let (levels, values) = parted(cells, |number| *number);
                writer.write_batch(&values, Some(&levels), None)?;
            }
            (Cells::Whole(cells), ColumnWriter::Int64ColumnWriter(writer)) => {
                let (levels, values) = parted(cells, |number| *number);
                writer.write_batch(&values, Some(&levels), None)?;
            }
            (Cells::Words(cells), ColumnWriter::ByteArrayColumnWriter(writer)) => {
                let (levels, values) = parted(cells, |word| ByteArray::from(word.as_str()));
                writer.write_batch(&values, Some(&levels), None)?;
            }
            _ => return Err(ParquetError::General("a column of another type".into())),
        }
        Ok(())
    }
}

/// Which cells are filled, 1 or 0, and what those hold.
fn parted<T, P>(cells: &[Option<T>], value: impl Fn(&T) -> P) -> (Vec<i16>, Vec<P>) {
    (cells.iter().map(|cell| cell.is_some().into()).collect(), cells.iter().flatten().map(value).collect())
}

/// How many cases have each status, the worst first.
pub fn counts(outcomes: &[Option<Outcome>]) -> [(Status, usize); 4] {
    let of = |status| outcomes.iter().flatten().filter(|outcome| outcome.status() == status).count();
    [Status::Failed, Status::Missed, Status::Done, Status::Met].map(|status| (status, of(status)))
}
