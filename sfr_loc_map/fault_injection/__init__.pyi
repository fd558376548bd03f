from .fault import Fault as Fault
from .fault import Outcome as Outcome
from .harness import Harness as Harness
from .run import run_campaign as run_campaign
from .settings import CampaignSettings as CampaignSettings
