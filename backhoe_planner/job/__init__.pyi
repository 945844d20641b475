from .cuts.bucket import Bucket as Bucket
from .cuts.candidates import cut_candidates as cut_candidates
from .cuts.candidates import price as price
from .cuts.cut import Cut as Cut
from .cuts.cut import NoCut as NoCut
from .cuts.digger import Digger as Digger
from .cuts.finding import find_cut as find_cut
from .cuts.profile import Profile as Profile
