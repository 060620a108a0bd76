from .io import (
    from_json as from_json,
    to_json as to_json,
)
from .law import Law as Law
from .objects import (
    average_law as average_law,
    select_objects as select_objects,
)
from .pooling import (
    contrasts as contrasts,
    pool_objects as pool_objects,
)
from .printing import (
    relations_frame as relations_frame,
    to_latex as to_latex,
    to_sympy as to_sympy,
)
from .provenance import (
    Alternative as Alternative,
    History as History,
    Provenance as Provenance,
    Step as Step,
)
from .script import to_script as to_script
from .tables import to_frame as to_frame
from .uncertainty import (
    Misfit as Misfit,
    PlausibleLaw as PlausibleLaw,
    Uncertainty as Uncertainty,
)
