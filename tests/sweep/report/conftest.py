from tests.report.conftest import unplaced as unplaced  # fixtures
