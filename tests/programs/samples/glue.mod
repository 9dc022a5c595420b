%%%
  VERSION:1
  LANGUAGE:ENGLISH
%%%
MODULE glue
  ! Klebeprogramm für Tür links  CONST robtarget pNo:=[[1,2,3],[1,0,0,0],[0,0,0,0],[0,0,0,0,0,0]];
  PERS tooldata tGlue:=[TRUE,[[31.792631019,0,229.638935148],[0.945518576,0,0.325568154,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];
  PERS wobjdata wDoor:=[FALSE,TRUE,"",[[1000,-40,800],[0.707106781,0,0,0.707106781]],[[10,20,30],[1,0,0,0]]];
  TASK PERS wobjdata wMoving:=[FALSE,FALSE,"STN_1",[[0,0,0],[1,0,0,0]],[[0,0,250],[1,0,0,0]]];
  CONST robtarget p10:=[[-192.68,-795.66,456.25],[1.13796E-06,0.727571,0.686033,-2.82384E-06],[-2,-1,0,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
  CONST robtarget p20:=[[506.291651,-150.257853,679.799999],[0.5,0,0.866025404,0],[0,0,0,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
  CONST robtarget p30:=[[1100,0,1200.5],[0,0,-1,0],[0,-2,-1,4],[-94.8062,9E+09,9E+09,9E+09,9E+09,9E+09]];
  LOCAL CONST jointtarget jHome:=[[0,-20.5,30,0,80.25,-1E1],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
  PROC main()
    MoveAbsJ jHome\NoEOffs,v1000,z50,tool0;
    MoveJ p10,v500,z20,tGlue\WObj:=wDoor;
    MoveL p20,v100,fine,tGlue\WObj:=wDoor;
    MoveL Offs(p20,0,0,100),v100,fine,tGlue\WObj:=wDoor;
    MoveL p30,v100,fine,tGlue\WObj:=wMoving;
  ENDPROC
ENDMODULE
