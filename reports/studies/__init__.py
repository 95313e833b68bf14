"""Studies: what a report finds out beside its ordinary tables, a folder each."""

from .ablation_ladder.study import AblationLadders
from .budgets.study import BudgetStudy
from .candidates.study import CandidateStudy
from .differences.study import DifferencesToBest
from .population.study import PopulationStudy
from .stability.study import StabilityStudy
from .study import Study

STUDIES: tuple[type[Study], ...] = (  # in the order of tables and of the page
    CandidateStudy,
    DifferencesToBest,
    AblationLadders,
    BudgetStudy,
    StabilityStudy,
    PopulationStudy,
)
