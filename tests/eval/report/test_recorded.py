"""What is written once a run is recorded: everything of a run alone, what its campaign shows of one in a campaign."""

import json
import shutil
from pathlib import Path

from litsim_eval.analysis.metrics import METRICS_FILE
from litsim_eval.report.analyze import FILES
from litsim_eval.report.recorded import RecordedAnalysis
from litsim_eval.report.run_report import REPORT_FILE
from litsim_eval.report.thumbnails import THUMBNAIL_FILE

BAG = Path(__file__).parents[2] / "sim/record/bags/format_1/format_1_0.mcap"


def test_a_run_of_a_campaign_gets_measures_and_report_and_a_picture_for_the_campaigns_page(tmp_path: Path) -> None:
    written = {}
    for name, case in (("alone", None), ("case", tmp_path / "case")):
        out = tmp_path / name / "run"
        out.mkdir(parents=True)
        shutil.copy(BAG, out)
        assert RecordedAnalysis(None)(out, quiet=True, failed=False, case=case) == 0
        written[name] = {path.name for path in out.iterdir()} - {BAG.name}
    assert written == {"alone": {*FILES, REPORT_FILE}, "case": {METRICS_FILE, REPORT_FILE}}
    alone, case = (json.loads((tmp_path / name / "run" / METRICS_FILE).read_text()) for name in written)
    assert alone == case
    assert [path.name for path in (tmp_path / "case").iterdir() if path.is_file()] == [THUMBNAIL_FILE]
    assert not [path for path in (tmp_path / "alone").iterdir() if path.is_file()]
