from .document import (
    Block as Block,
    Fold as Fold,
    Gallery as Gallery,
    Picture as Picture,
    Report as Report,
    Section as Section,
    Table as Table,
    Text as Text,
    check_packages as check_packages,
    to_page as to_page,
)
from .notebook import notebook_html as notebook_html
from .printing import (
    browser as browser,
    printed as printed,
)
from .sections import (
    law_page as law_page,
    law_report as law_report,
)
